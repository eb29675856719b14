"""python-can without what it imports for log files in MDF, which are two thirds of the start of a bench's process."""

from __future__ import annotations

import importlib
import sys
from typing import Any


def import_can_without_mdf() -> None:
    """Import python-can as if asammdf were not installed; python-can's own MF4 files can't be used afterwards.

    For a process of ours that is about to run: asammdf brings pandas, pyarrow and canmatrix with it. hilbench imports
    asammdf by itself when it reads or writes a recording. Nothing happens where python-can is imported already.
    """
    if "can" in sys.modules or "asammdf" in sys.modules:
        return
    hidden: dict[str, Any] = sys.modules
    hidden["asammdf"] = None  # an import of it raises ImportError, which python-can is prepared for
    try:
        importlib.import_module("can")
    finally:
        del hidden["asammdf"]
