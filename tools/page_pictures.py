"""Pictures of the page in the browser for the docs: beside a run, before a change, after an emergency stop, of an ended
run, and on a narrow screen.

    python tools/page_pictures.py [--out docs/images]

needs Debian's chromium.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from page_cost import CONFIG, ended
from playwright.sync_api import Page, sync_playwright

_RUNNING: Final = "document.body.dataset.condition === 'running'"
#: Experiment time at which the first picture is taken: E has stepped, and the tension is back.
_AT_S: Final = 14.0
_PATIENCE_S: Final = 180


def until(page: Page, condition: str) -> None:
    """Wait for something to be so; text is not run as a script on this page, so it is asked for again and again."""
    for _ in range(_PATIENCE_S * 10):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(100)
    raise RuntimeError(f"{condition} did not come")


def main() -> None:
    """Take them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    out: Path = parser.parse_args().out
    hilbench, options = [sys.executable, "-m", "hilbench"], ["--bus", f"embedded:pictures-{os.getpid()}"]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack, sync_playwright() as playwright:
        runs = Path(folder) / "runs"
        served = [*hilbench, "monitor", str(CONFIG), *options, "--browser", "--port", "0", "--runs", str(runs)]
        server = stack.enter_context(ended(subprocess.Popen(served, stdout=subprocess.PIPE, text=True)))
        ran = [*hilbench, "run", str(CONFIG), *options, "--out", str(runs)]
        run = stack.enter_context(ended(subprocess.Popen(ran, stdout=subprocess.DEVNULL, text=True)))
        assert server.stdout is not None
        address = server.stdout.readline().removeprefix("page: ").strip()
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 1130})
        page.goto(address)
        until(page, _RUNNING)
        page.fill("#who", "anna")
        page.click("#take")
        until(page, f"parseFloat(document.querySelector('#clock').textContent.slice(4)) > {_AT_S}")
        page.screenshot(path=out / "page_running.png")
        page.fill("#field-v", "5")
        page.click("#set-v")
        until(page, "!document.querySelector('#futures').hidden")
        page.wait_for_timeout(500)
        page.locator("#ask").screenshot(path=out / "page_before_a_change.png")
        page.click("#no")
        page.set_viewport_size({"width": 390, "height": 844})
        page.wait_for_timeout(500)
        page.screenshot(path=out / "page_narrow.png")
        page.set_viewport_size({"width": 1440, "height": 1130})
        page.click("#stop")
        page.click("#yes")
        run.wait(_PATIENCE_S)
        until(page, "!document.querySelector('#ended').hidden")
        page.screenshot(path=out / "page_stopped.png")
        played = [*hilbench, "monitor", str(runs), "--browser", "--port", "0"]
        library = stack.enter_context(ended(subprocess.Popen(played, stdout=subprocess.PIPE, text=True)))
        assert library.stdout is not None
        page.goto(library.stdout.readline().removeprefix("page: ").strip())
        page.click("text=play again")
        until(page, "!document.querySelector('#paces').hidden")
        page.click("text=fast")
        until(page, f"parseFloat(document.querySelector('#clock').textContent.slice(4)) > {_AT_S}")
        page.screenshot(path=out / "page_replay.png")
        browser.close()


if __name__ == "__main__":
    main()
