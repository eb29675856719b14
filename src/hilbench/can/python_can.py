"""python-can, imported without asammdf: get it from here.

python-can imports asammdf, and with it pandas, for a log format that nobody here writes by it. That takes ten times as
long as python-can itself, in each process of a bench.
"""

from __future__ import annotations

import sys
from typing import Any

_LOADED: dict[str, Any] = sys.modules
if "can" not in _LOADED and "asammdf" not in _LOADED:
    _LOADED["asammdf"] = None  # to `import`: there is no such module
    import can as can

    del _LOADED["asammdf"]
else:
    import can as can
