"""python-can, imported without asammdf: get it from here.

python-can imports asammdf, and with it pandas, for a log format that nobody here writes by it. That takes ten times as
long as python-can itself, in each process of a bench. A program that wants python-can's own MF4 logger imports `can`
before hilbench.
"""

from __future__ import annotations

from hilbench.hidden import hidden

with hidden("asammdf"):
    import can as can
