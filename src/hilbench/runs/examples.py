"""Example configs that are shipped with their EDS files and tables: part of the wheel, or of the checkout."""

from __future__ import annotations

from pathlib import Path

from hilbench.did_you_mean import did_you_mean
from hilbench.errors import UnusableInputError
from hilbench.files import make_folder, written_whole
from hilbench.runs.config import files_of

#: The published experiment, which `hilbench demo` and `make demo` run.
PUBLISHED = "web_section_step"
#: The folders of the checkout, which the wheel has as hilbench/examples: configs name EDS files as ../eds/NAME.
CONFIGS, EDS = "bench_configs", "eds"


def shipped() -> Path:
    """The folder in which `bench_configs` and `eds` are."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "examples"
    return installed if installed.is_dir() else package.parents[1]


def names() -> list[str]:
    """The names of the example configs: paths below `bench_configs` without the ending."""
    folder = shipped() / CONFIGS
    return sorted(path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.yaml"))


def config_of(name: str) -> Path:
    """The shipped config of a name. Raises UnusableInputError where there is none."""
    if name not in names():
        known = did_you_mean(name, names()) or ", expected one that `hilbench examples` lists"
        raise UnusableInputError("NAME", f"no example '{name}'{known}")
    return shipped() / CONFIGS / f"{name}.yaml"


def copy(name: str, to: Path) -> list[Path]:
    """Copy a config, with what it includes and names, to `bench_configs` and `eds` in a folder; the files, the config
    first. What is there already stays. Raises UnusableInputError for an unknown name, or where a file can't be written.
    """
    config = config_of(name)
    beside = () if "/" not in name else sorted(each for each in config.parent.iterdir() if each.is_file())
    return _copied([config, *files_of(config), *beside], to)


def copy_eds(files: list[str], to: Path) -> None:
    """Copy EDS files to `eds` in a folder. What is there already stays. Raises UnusableInputError as `copy`."""
    _copied([shipped() / EDS / name for name in files], to)


def _copied(sources: list[Path], to: Path) -> list[Path]:
    copies = {to / source.relative_to(shipped()): source for source in sources}
    for path, source in copies.items():
        if not path.exists():
            make_folder(path.parent)
            with written_whole(path) as partial:  # what a full disk cut off would be kept the next time
                partial.write_bytes(source.read_bytes())
    return list(copies)
