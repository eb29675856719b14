"""The page of a library of runs: one file, everything escaped, found and compared in a browser."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.cli.in_process import hilbench
from tests.library.made_runs import criterion, made_run
from tests.report.parsed import EVIL, ParsedPage, parsed

from hilbench.apps.library.labels import note, tag


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of twelve runs, the last not passed; one has a note that would like to be markup."""
    base = tmp_path_factory.mktemp("library")
    for number in range(12):
        folder = made_run(base / "runs", number=number, criteria=[criterion("E found", passed=number < 11)])
        folder.report.write_text("<title>the report</title>")
    note(folder, EVIL)
    tag(folder, add=["golden"])
    done = hilbench("runs", "list", "--runs", base / "runs", "--html", base / "pages.html")
    assert done.returncode == 0, done.stderr
    return base / "pages.html"


def test_nothing_comes_from_outside_and_only_the_page_s_own_scripts_run(page: Path) -> None:
    source, found = page.read_text(), parsed(page)
    assert isinstance(found, ParsedPage)
    assert not {"link", "img", "iframe", "object"} & set(found.tags)
    data, *code = found.scripts
    assert len(json.loads(data)["runs"]) == 12
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in code]
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', source)
    assert policy.endswith("script-src " + " ".join(f"'sha256-{text}'" for text in hashes))
    assert EVIL not in source


def test_without_a_script_the_runs_are_there_too(page: Path) -> None:
    without = re.sub(r"<script.*?</script>", "", page.read_text(), flags=re.DOTALL)
    assert len(re.findall(r"<code>web-2026", without)) == 12


@pytest.fixture
def browser() -> Iterator[Any]:
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("Chromium is not installed")
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield started
        started.close()


def test_somebody_finds_draws_compares_and_opens_runs(page: Path, browser: Any) -> None:
    shown = browser.new_page()
    said: list[str] = []
    shown.on("console", lambda message: said.append(message.text))
    shown.on("pageerror", lambda error: said.append(str(error)))
    shown.goto(page.as_uri())
    rows = shown.locator("#runs tbody tr")
    assert rows.count() == 12
    assert EVIL in rows.nth(0).inner_text()
    shown.fill("#words", "GOLDEN")
    assert rows.count() == 1
    shown.fill("#words", "")
    shown.select_option("#result", "failed")
    assert rows.count() == 1
    shown.select_option("#result", "")
    shown.select_option("#metric", "E_time_to_1pct_s")
    assert shown.locator("#plot canvas").is_visible()
    shown.fill("#least", "0.155")
    assert rows.count() == 6
    assert shown.locator("#count").inner_text() == "6 of 12 runs"
    shown.get_by_role("button", name="E_time_to_1pct_s").click()
    assert [row.split("\t")[6] for row in rows.all_inner_texts()] == ["0.21", "0.2", "0.19", "0.18", "0.17", "0.16"]
    rows.nth(0).locator("input").check()
    rows.nth(1).locator("input").check()
    compared = shown.locator("#comparison tbody tr", has_text="E_time_to_1pct_s")
    assert compared.inner_text().split("\t") == ["E_time_to_1pct_s", "0.21", "0.2", "−0.01"]
    assert shown.locator("#command").inner_text().startswith("hilbench compare web-2026")
    rows.nth(0).locator("a").click()
    assert shown.title() == "the report"
    assert said == []
