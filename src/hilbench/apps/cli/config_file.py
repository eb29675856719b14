"""Config of a command; the models that check it take their time to import."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hilbench.errors import UnusableInputError

if TYPE_CHECKING:
    from hilbench.runs.config import LoadedConfig


def load_config(config: Path, **overrides: Any) -> LoadedConfig:
    """The config with the values of options; an example that is not copied yet is named. Raises UnusableInputError."""
    from hilbench.runs.config import load_with_overrides

    try:
        os.fsencode(config.absolute()).decode("utf-8")
    except UnicodeDecodeError:  # its result could not be written
        raise UnusableInputError(config, "the path is not UTF-8 text, expected one") from None
    try:
        return load_with_overrides(config, **overrides)
    except UnusableInputError as error:
        from hilbench.runs.examples import names

        if not config.exists() and config.stem in names():
            error.add_note(f"`hilbench examples {config.stem}` copies the example of this name to bench_configs")
        raise
