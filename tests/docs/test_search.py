"""The search of the docs, in the site as `make docs` builds it and README opens it: from a file."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from html import unescape
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

pytestmark = [pytest.mark.docs, pytest.mark.skipif(BROWSER is None, reason="needs chromium (Debian: chromium)")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("docs") / "site"
    build = [Path(sys.executable).parent / "mkdocs", "build", "--quiet", "--site-dir", folder]
    subprocess.run(build, cwd=ROOT, check=True)
    return folder


def shown(address: str, folder: Path) -> str:
    """The page as a browser has it once its scripts have run."""
    profile = f"--user-data-dir={folder / 'profile'}"
    options = ["--headless", "--no-sandbox", "--disable-gpu", profile, "--virtual-time-budget=60000", "--dump-dom"]
    done = subprocess.run([BROWSER or "", *options, address], capture_output=True, text=True, check=True, timeout=300)
    return done.stdout


@pytest.mark.parametrize(
    ("words", "page"),
    [
        ("bandwidth_rad_per_s", "./reference/config.html"),
        ("emergency stop", "./faults.html"),
        ("mirrorin", "./reference/config.html"),  # the beginning of a word
        ("faulted", "./faults.html"),  # another form of it
        ("6041h", "./reference/objects.html"),
    ],
)
def test_it_finds_the_page_that_has_the_words(site: Path, tmp_path: Path, words: str, page: str) -> None:
    found = shown(f"{(site / 'search.html').as_uri()}?q={words.replace(' ', '+')}", tmp_path)
    links = [unescape(link) for link in re.findall(r'<article><h3><a href="([^"]+)"', found)]
    assert page in {link.partition("#")[0] for link in links}
    assert all((site / link.partition("#")[0]).is_file() for link in links)


def test_it_says_when_nothing_is_found(site: Path, tmp_path: Path) -> None:
    found = shown(f"{(site / 'search.html').as_uri()}?q=hovercraft", tmp_path)
    assert "<article>" not in found
    assert re.search(r'id="mkdocs-search-results"[^>]*>No results found<', found)


def test_every_page_has_a_field_that_leads_there(site: Path, tmp_path: Path) -> None:
    for page, to in (("index.html", "./search.html"), ("reference/config.html", "../search.html")):
        found = shown((site / page).as_uri(), tmp_path)
        assert re.search(rf'<form[^>]* action="{re.escape(to)}"[^>]*>\s*<input[^>]* name="q"', found)
