"""Examine the simulated drive and write the table: ``python tools/conformance_table.py --write``.

The drive is that of ``eds/hilbench_servo.eds``, examined in one thread with time that is counted. It has no write-only
object: SDO 4 and OD 4 are examined on a test device with the same runtime. Nothing is written when a case fails.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import docs_page

from hilbench.apps.conformance.examine import AFTERWARDS, examine
from hilbench.apps.conformance.record import CaseResult, Verdict

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # the tests' helpers are imported from there

from tests.canopen.device_under_test import SECTIONS, eds_text  # noqa: E402
from tests.conformance.virtual_bus import VirtualBus, under_test  # noqa: E402

_ON_THE_TEST_DEVICE = ("SDO 4", "OD 4")


def examined() -> list[CaseResult]:
    """Every case of the servo drive."""
    with tempfile.TemporaryDirectory() as folder:
        eds = Path(folder) / "device.eds"
        eds.write_text(eds_text(SECTIONS), encoding="ascii")
        others = {result.name: result for result in examine(under_test(VirtualBus(eds), eds), ["SDO", "OD"])}
    results = examine(under_test(VirtualBus(), motion=True, store=True))
    return [
        others[result.name] if result.name in _ON_THE_TEST_DEVICE else result
        for result in results
        if result.group != AFTERWARDS.group
    ]


def rows(results: Sequence[CaseResult]) -> list[list[str]]:
    """Of the table, a row a case. Raises ValueError when a case has failed."""
    failed = [result.name for result in results if result.verdict not in (Verdict.PASSED, Verdict.NOT_APPLICABLE)]
    if failed:
        raise ValueError(f"{', '.join(failed)}: expected all to pass")
    return [[one.group, str(one.number), one.title, one.clause, one.verdict, one.reason] for one in results]


def summary(rows: list[docs_page.Row]) -> str:
    """Cases by group, and why some are not applicable."""
    lines, whole, reasons = [], [], Counter[str]()
    for group, members in groupby(rows, key=lambda row: row["group"]):
        found = list(members)
        out = [row for row in found if row["result"] != Verdict.PASSED]
        reasons.update(row["reason"] for row in out)
        if out:
            lines.append((group, str(len(found)), str(len(found) - len(out)), ", ".join(row["case"] for row in out)))
        else:
            whole.append(f"{group} ({len(found)})")
    return "\n".join(
        [
            f"{len(rows)} cases: {len(rows) - reasons.total()} passed, {reasons.total()} not applicable. All passed in "
            f"{', '.join(whole)}; in the other groups",
            "",
            docs_page.markdown(("group", "cases", "passed", "not applicable"), lines),
            "",
            f"because {'; '.join(f'{reason} ({count})' for reason, count in reasons.most_common())}.",
        ]
    )


TABLE = docs_page.Table(
    "conformance", "conformance.md", ("group", "case", "title", "clause", "result", "reason"), summary
)


def main() -> int:
    """Exit code 0."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    found = rows(examined())
    if parser.parse_args().write:
        TABLE.write(found)
    else:
        print(docs_page.markdown(TABLE.columns, found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
