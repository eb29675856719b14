"""The fault matrix: every fault is made on a real run (real processes, a real bus), and its outcome is tabulated.

    python tools/fault_matrix.py                 print the table
    python tools/fault_matrix.py --write         write docs/tables/faults.csv, a summary into docs/fault_tests.md
    python tools/fault_matrix.py --only twin     only the faults with this in their name
    python tools/fault_matrix.py --only kill --bus socketcan:vcan0      on another bus; faults of the hub are left out
    python tools/fault_matrix.py --take FILE     put the marks of a table that was printed elsewhere there

A row passes when the run ended with the expected exit code and said the expected words. "To safe state" counts cycles
from the fault until every drive shows by its statusword (PDO, or SDO after an emergency stop) that it stands or has no
power. "Kept" are the samples of the recording, recovered from the trace where the run was cut off.

Rows in real time run with cycles of 10 ms, the time-outs of a slow bench and a softer web (the load motor can't emulate
a stiff one over such a cycle): what is tested is the fault, not this machine. A row that fails while more than 2 % of
the cycles were missed is made again, up to three times; when it still does, it is marked "busy". Exit code 1 when a row
does not pass.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
from pathlib import Path

from docs_page import markdown
from faults.catalogue import faults
from faults.outcome import execute
from faults.table import COLUMNS, cells, printed, write


def main() -> int:
    """Make the faults, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write docs/tables/faults.csv and docs/fault_tests.md")
    parser.add_argument("--only", default="", help="only faults whose name this regular expression is found in")
    parser.add_argument("--bus", help="the bus to run on, e.g. socketcan:vcan0, with nobody else on it")
    parser.add_argument("--take", type=Path, metavar="FILE", help="make nothing: the table is in this file")
    options = parser.parse_args()
    if options.take:
        write(printed(options.take.read_text(encoding="utf-8"), faults()), faults())
        return 0
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        # Buses of our own: `hilbench estop` without an address stops every bus of the user.
        os.environ["XDG_RUNTIME_DIR"] = folder
        return _make(options.only, options.bus, options.write)


def _make(only: str, bus: str | None, to_page: bool) -> int:
    rows, all_passed = [], True
    for fault in faults():
        if not re.search(only, fault.name) or (bus and fault.embedded):
            continue
        row = execute(fault, bus)
        all_passed &= row.passed
        rows.append(cells(row, bus))
        print(f"{'ok ' if row.passed else 'BAD'} {fault.name}: {row.said[:1000]}", file=sys.stderr, flush=True)
        if to_page:
            write(rows[-1:], faults())
    print(markdown(COLUMNS, rows))
    return 0 if all_passed else 1


if __name__ == "__main__":
    sys.exit(main())
