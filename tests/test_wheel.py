"""The wheel alone, in an empty folder: README's first page works, and nothing is compiled."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.docs.shown import ROOT, shown
from tools.wheel import build

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Installed:
    """A venv with the wheel, beside the packages of the present one, and an empty folder."""

    program: Path
    site: Path
    folder: Path
    home: Path

    def run(self, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
        """`hilbench` with these words in the folder; who runs it has nothing but the wheel."""
        environment = {"PATH": os.environ["PATH"], "HOME": str(self.home), **variables}
        command = [str(self.program), *words]
        return subprocess.run(
            command, cwd=self.folder, env=environment, capture_output=True, text=True, timeout=600, check=False
        )

    def machine_code(self) -> set[Path]:
        """Files of machine code, of the wheel and of the user."""
        return {*self.site.rglob("*.nbc"), *self.home.rglob("*.nbc")}


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run([sys.executable, "-m", "hilbench", "compile"], check=True, stdout=subprocess.DEVNULL)
    wheel = build(folder / "dist")
    assert wheel.name.endswith(f"-cp{sys.version_info.major}{sys.version_info.minor}-linux_{os.uname().machine}.whl")
    venv.create(folder / "venv", with_pip=False)
    python = folder / "venv" / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index"]
    elsewhere = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([*pip, str(wheel)], env=elsewhere, check=True)
    site = next((folder / "venv" / "lib").glob("python3*/site-packages"))
    # What lies beside it there is found; .pth files of that folder, which lead to the checkout, are not followed.
    packages = [path for path in sys.path if path.endswith("site-packages")]
    (site / "present.pth").write_text("\n".join(packages) + "\n")
    for name in ("home", "work"):
        (folder / name).mkdir()
    return Installed(folder / "venv" / "bin" / "hilbench", site, folder / "work", folder / "home")


def first_page() -> Sequence[tuple[str, ...]]:
    """The hilbench commands of README, in its order."""
    texts = [line.text for line in shown() if line.place.startswith("README.md:")]
    return list(dict.fromkeys(tuple(text.split()[1:]) for text in texts if text.startswith("hilbench ")))


def test_the_readme_works_in_an_empty_folder_and_compiles_nothing(installed: Installed) -> None:
    before = installed.machine_code()
    assert len(before) > 40
    where = installed.run("--version")
    assert where.returncode == 0, where.stderr
    ran = []
    for words in first_page():
        if words[0] in ("monitor", "estop"):  # beside a run; without one they say that there is none
            words = ("monitor", "--help") if words[0] == "monitor" else ("estop", "--help")
        if words[:2] == ("config", "new"):
            words = (*words, "--defaults")
        done = installed.run(*words)
        assert done.returncode == 0, f"{words}: {done.stdout[-2000:]}\n{done.stderr}"
        assert "compiling" not in done.stdout + done.stderr, words
        ran.append(words[0])
    assert {"demo", "examples", "run", "diagnose", "config", "check"} <= set(ran)
    assert str(ROOT) not in "".join(path.read_text() for path in installed.folder.glob("runs/*/config.yaml"))
    assert installed.machine_code() == before
