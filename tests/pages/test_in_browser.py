"""The page in a real browser, beside runs as a user starts them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.bench.whole_runs import ENDLESS, config, run_folders, start
from tests.pages.page_server import Server

from hilbench.errors import EXIT_BENCH_FAULT, EXIT_INTERRUPTED
from hilbench.results.journal import read_journal
from hilbench.results.result import Result
from hilbench.results.run_folder import RunFolder

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on PATH: Debian's package of that name has it"),
]

#: A loaded machine starts a bench and a browser slowly; nothing waits so long that does not have to.
PATIENCE_MS = 60_000


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    api = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install .[dev] has it")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def opened(browser: Browser, address: str) -> Page:
    """Somebody's browser at an address, with a session of its own."""
    page = browser.new_context().new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address)
    return page


def until(page: Page, condition: str) -> None:
    until_s = time.monotonic() + PATIENCE_MS / 1000
    while not page.evaluate(condition):  # `wait_for_function` is what the page's policy refuses: text run as a script
        assert time.monotonic() < until_s, f"{condition} did not come; shown: {page.inner_text('body')[:2000]}"
        page.wait_for_timeout(50)


def text(page: Page, place: str) -> str:
    return page.locator(place).inner_text()


RUNNING = "document.body.dataset.condition === 'running' && document.querySelector('#clock').textContent !== ''"


def test_a_run_is_watched_changed_and_stopped_by_two(browser: Browser, tmp_path: Path) -> None:
    path = config(tmp_path, steps=ENDLESS)
    server, run = Server(path), start(path, report=True)
    anna, ben = opened(browser, server.address), opened(browser, server.address)
    for page in (anna, ben):
        until(page, RUNNING)
    assert "#" not in anna.url  # the token does not stay in the address
    before = text(anna, "#clock")
    until(anna, f"document.querySelector('#clock').textContent !== {json.dumps(before)}")
    assert "OPERATION ENABLED" in text(ben, "#nodes")
    assert anna.locator("figure canvas").count() == 5

    anna.fill("#who", "anna")
    anna.click("#take")
    until(ben, "document.querySelector('#seat').textContent.includes('anna controls')")
    assert ben.locator("#set-v").is_disabled()
    until(anna, "!document.querySelector('#set-v').disabled")
    anna.fill("#field-v", "1.5")
    anna.click("#set-v")
    anna.click("#yes")
    now = "document.querySelector('.quantity .now').textContent"
    until(ben, f"{now}.startsWith('1.5')")

    ben.fill("#who", "ben")
    anna.click("#set-v")
    assert anna.locator("#stop-there").is_visible()  # a dialogue does not take the button away
    anna.click("#no")
    ben.click("#stop")
    assert run.poll() is None  # once is not enough
    ben.click("#yes")
    assert run.wait(PATIENCE_MS / 1000) == EXIT_BENCH_FAULT
    for page in (anna, ben):
        until(page, "document.body.dataset.condition === 'E-STOP'")
        until(page, "document.querySelector('#ended').textContent.includes('fault')")
        assert "emergency stop" in text(page, "#events")
        until(page, "document.querySelector('#ended a') !== null")  # the report is written a moment later
    assert anna.locator("#set-v").is_disabled()
    folder = RunFolder(run_folders(path)[0])
    assert "emergency stop" in Result.read(folder.result).faults[0].text
    asked = [(change.who, change.path) for change in read_journal(folder.journal) if change.what == "asked"]
    assert asked == [
        ("anna (127.0.0.1)", "control taken"),
        ("anna (127.0.0.1)", "line speed 1.5 m/s: set"),
        ("ben (127.0.0.1)", "emergency stop"),
    ]
    server.end()


def test_who_was_there_before_the_run_sees_it_from_its_first_sample(browser: Browser, tmp_path: Path) -> None:
    # a browser that starts beside it may hold up a real-time run for longer than the 25 cycles that a stand allows
    path = config(tmp_path, steps=ENDLESS, safety={"missing_cycles": 1000})
    server = Server(path, "--pace", "realtime")
    anna, errors = opened(browser, server.address), []
    anna.on("pageerror", lambda error: errors.append(str(error)))
    until(anna, "document.body.dataset.condition === 'not received'")
    anna.wait_for_timeout(500)  # plots without a sample are drawn
    run = start(path, "--pace", "realtime")
    until(anna, RUNNING)
    until(anna, "!document.querySelector('[data-plot=tension] .u-legend').innerText.includes('–')")
    assert errors == []

    anna.fill("#who", "anna")
    anna.click("#take")
    until(anna, "!document.querySelector('#set-v').disabled")
    anna.fill("#field-v", "9.5")
    anna.click("#set-v")
    until(anna, "document.querySelector('#said').textContent.includes('expected a number from −8 to 8 m/s')")
    assert not anna.locator("#ask").is_visible()
    run.send_signal(signal.SIGINT)
    assert run.wait(PATIENCE_MS / 1000) == EXIT_INTERRUPTED
    server.end()


def test_a_stranger_sees_nothing_and_a_server_that_is_killed_leaves_the_run_alone(
    browser: Browser, tmp_path: Path
) -> None:
    path = config(tmp_path, steps=ENDLESS)
    run, server = start(path), Server(path)
    stranger = opened(browser, server.address.partition("#")[0])
    until(stranger, "!document.querySelector('#refused').hidden")
    assert stranger.locator("#all").is_hidden()
    assert "web_section_step" not in stranger.content()
    anna = opened(browser, server.address)
    until(anna, RUNNING)
    os.kill(server.process.pid, signal.SIGKILL)
    until(anna, "!document.querySelector('#lost').hidden")
    anna.click("#stop")
    anna.click("#yes")
    until(anna, "document.querySelector('#said').textContent.includes('NOT SENT')")
    trace = run_folders(path)[0] / "trace.log"
    written = trace.stat().st_size
    again = Server(path)
    back = opened(browser, again.address)
    until(back, RUNNING)
    assert trace.stat().st_size > written
    assert run.poll() is None
    back.reload()  # the session stays
    until(back, RUNNING)
    back.keyboard.press("e")
    back.keyboard.press("e")
    assert run.wait(PATIENCE_MS / 1000) == EXIT_BENCH_FAULT
    again.end()


def test_the_runs_of_a_folder_are_listed_without_a_bench(browser: Browser, ran: object, tmp_path: Path) -> None:
    outcome = ran[1]  # type: ignore[index]
    server = Server(outcome.folder.path.parent)
    page = opened(browser, server.address)
    page.wait_for_selector(f"text={outcome.folder.name}")
    assert outcome.result.verdict in text(page, "#runs")
    server.end()
