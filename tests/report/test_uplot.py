"""The library inside the reports is the published one, file by file."""

from __future__ import annotations

import hashlib
import json
import shutil
from importlib import resources
from pathlib import Path

import pytest
from tests.foreign.foreign_station import PACKAGES

HERE = resources.files("hilbench.apps.report").joinpath("uplot")
SOURCE = json.loads(HERE.joinpath("source.json").read_text(encoding="utf-8"))
LOCK = json.loads((Path(__file__).parents[1] / "foreign" / "package-lock.json").read_text())


def test_every_file_has_the_recorded_sum_and_the_licence_is_there() -> None:
    for name, sha256 in SOURCE["files"].items():
        assert hashlib.sha256(HERE.joinpath(Path(name).name).read_bytes()).hexdigest() == sha256
    assert "MIT" in HERE.joinpath("LICENSE").read_text(encoding="utf-8")
    assert f"(v{SOURCE['version']})" in HERE.joinpath("uPlot.iife.min.js").read_text(encoding="utf-8")


def test_version_and_integrity_are_those_of_the_lock_file() -> None:
    locked = LOCK["packages"]["node_modules/uplot"]
    assert (locked["version"], locked["integrity"]) == (SOURCE["version"], SOURCE["integrity"])


@pytest.mark.skipif(shutil.which("npm") is None, reason="Node.js with npm is not installed")
def test_the_files_are_those_that_npm_installs_by_that_integrity() -> None:
    package = PACKAGES / "uplot"
    assert package.exists(), "uplot is missing: make .cache/node-canopen/.installed"
    for name in SOURCE["files"]:
        assert HERE.joinpath(Path(name).name).read_bytes() == (package / name).read_bytes()
