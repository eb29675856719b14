"""python-can, imported without asammdf: get it from here.

python-can imports asammdf, and with it pandas, for a log format that is not written by it here. That takes ten times
as long as python-can itself, in each process of a bench. A program that wants python-can's own MF4 logger imports `can`
before hilbench.
"""

from __future__ import annotations

import sys

_NAME = "asammdf"
_is_hidden = _NAME not in sys.modules
if _is_hidden:
    sys.modules[_NAME] = None  # type: ignore[assignment]  # it can't be imported
try:
    import can as can
finally:
    if _is_hidden:
        del sys.modules[_NAME]
