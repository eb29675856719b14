"""Examine the simulated drive and write the table: ``python tools/conformance_table.py --write docs/conformance.md``.

The drive is that of ``eds/hilbench_servo.eds``, examined in one thread with time that is counted. It has no write-only
object: SDO 4 and OD 4 are examined on a test device with the same runtime. Nothing is written when a case fails.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from hilbench.apps.conformance.examine import AFTERWARDS, examine
from hilbench.apps.conformance.record import CaseResult, Verdict

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # the tests' helpers are imported from there

from tests.canopen.device_under_test import SECTIONS, eds_text  # noqa: E402
from tests.conformance.virtual_bus import VirtualBus, under_test  # noqa: E402

BEGIN, END = "<!-- table: tools/conformance_table.py -->\n", "<!-- end of table -->\n"
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


def table(results: Sequence[CaseResult]) -> str:
    """What stands between the marker lines. Raises ValueError when a case has failed."""
    failed = [result.name for result in results if result.verdict not in (Verdict.PASSED, Verdict.NOT_APPLICABLE)]
    if failed:
        raise ValueError(f"{', '.join(failed)}: expected all to pass")
    passed = sum(result.verdict is Verdict.PASSED for result in results)
    lines = [f"{len(results)} cases: {passed} passed, {len(results) - passed} not applicable.\n"]
    for group, members in groupby(results, key=lambda result: result.group):
        lines += [f"\n### {group}\n", "\n| | case | clause | result |\n", "|---|---|---|---|\n"]
        lines += [f"| {one.number} | {one.title} | {one.clause} | {_result(one)} |\n" for one in members]
    return "".join(lines)


def _result(one: CaseResult) -> str:
    return one.verdict if one.verdict is Verdict.PASSED else f"{one.verdict}: {one.reason}"


def with_table(page: str, text: str) -> str:
    """The page with `text` between its marker lines. Raises ValueError when they are missing."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the page lacks the lines '{BEGIN.strip()}' and '{END.strip()}'")
    return f"{before}{begin}{text}{end}{after}"


def main() -> int:
    """Exit code 0."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--write", type=Path, metavar="PAGE", help="bring the table of this page up to date")
    arguments = parser.parse_args()
    text = table(examined())
    if arguments.write is None:
        print(text, end="")
    else:
        arguments.write.write_text(with_table(arguments.write.read_text(encoding="utf-8"), text), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
