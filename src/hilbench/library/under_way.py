"""Whether a run still goes on."""

from __future__ import annotations

import time
from typing import Final

from hilbench.results.run_folder import RunFolder

#: A trace without a result that was written to so lately is taken for one that is being written, where the system does
#: not tell whose lock is whose, s.
_LATELY_S: Final = 5.0


def goes_on(folder: RunFolder) -> bool:
    """Whether its bench has the trace locked, or, without a result, wrote to it a moment ago."""
    from hilbench.results.under_way import is_written  # slow to import, and few runs are asked

    if is_written(folder.trace):
        return True
    try:
        return not folder.result.exists() and time.time() - folder.trace.stat().st_mtime < _LATELY_S
    except OSError:
        return False
