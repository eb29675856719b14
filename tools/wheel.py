"""Build a wheel for this interpreter with the machine code of all compiled functions in it.

The code is what `hilbench compile` has left beside the sources: it is for every processor of this architecture, and
found where the wheel is installed, also where nobody can write there.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from numba.core.caching import IndexDataCacheFile, _hash_source_file

#: Name of numba's index of a function: module, function, line, version of Python.
_INDEX = re.compile(r"(\w+)\..+-\d+\.py\d+\.nbi")

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "hilbench"


def build(out: Path) -> Path:
    """The wheel, in a folder. Raises CalledProcessError where it can't be built."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
        subprocess.run([*pip, "--wheel-dir", str(folder), str(ROOT)], check=True)
        (plain,) = folder.glob("*.whl")
        _wheel("unpack", "--dest", str(folder), str(plain))
        (unpacked,) = (each for each in folder.iterdir() if each.is_dir())
        _add_machine_code(unpacked)
        out.mkdir(parents=True, exist_ok=True)
        before = set(out.glob("*.whl"))
        _wheel("pack", "--dest-dir", str(out), str(unpacked))
        (packed,) = set(out.glob("*-none-any.whl")) - (before - {out / plain.name})
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        tags = ["--python-tag", python, "--abi-tag", python, "--platform-tag", platform]
        tagged = _wheel("tags", "--remove", *tags, str(packed))
        return out / tagged.strip().splitlines()[-1]


def _add_machine_code(to: Path) -> None:
    """Copy what is kept of the sources as they are now, for every processor."""
    index: Any = IndexDataCacheFile
    for path in PACKAGE.rglob("*.nbi"):
        named = _INDEX.fullmatch(path.name)
        source = path.parent.parent / f"{named[1]}.py" if named else path
        folder = to / path.parent.relative_to(PACKAGE.parent)
        if named is None or not source.is_file():
            continue
        stamp = _hash_source_file(str(source), source.stat().st_mtime, source.stat().st_size)
        kept, copy = (index(str(each), path.stem, stamp) for each in (path.parent, folder))
        code = {key: name for key, name in kept._load_index().items() if key[1][1] == "generic"}
        if code:
            folder.mkdir(exist_ok=True)
            copy._save_index(code)
            for name in code.values():
                shutil.copyfile(path.parent / name, folder / name)


def _wheel(*arguments: str) -> str:
    command = [sys.executable, "-m", "wheel", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def main() -> None:
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("out", type=Path, help="folder for the wheel")
    wheel = build(options.parse_args().out)
    print(f"{wheel}: {wheel.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
