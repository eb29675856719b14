"""Fit the grey-box model of a winding line to the first half of a recording, and run it freely over the second.

    python tools/fit_winding_line.py winding.csv.gz [--docs]

Columns in this order, after the time in s: speeds of unwinder, pacer, rewinder; currents of unwinder and rewinder;
tensions of the two spans. `--docs` writes the table into docs/diagnosis.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from docs_page import put
from winding_line import LineFit, LineRecording, fit_line

_PAGE = Path(__file__).resolve().parents[1] / "docs" / "diagnosis.md"
#: Rows in which what was before the recording is forgotten.
_SETTLE = 10


def read(path: Path) -> LineRecording:
    """The columns of a CSV file, compressed or not."""
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    if table.ndim != 2 or table.shape[1] != 8 or not np.all(np.isfinite(table)):
        raise SystemExit(f"{path}: expected a header and eight columns of numbers: time, speeds, currents, tensions")
    return LineRecording(float(np.median(np.diff(table[:, 0]))), *table.T[1:])


def table(fit: LineFit) -> str:
    """Markdown."""
    rows = ["| parameter | value | standard deviation | identified by itself |", "|---|--:|--:|---|"]
    for p in fit.parameters:
        identified = "yes" if p.is_identified else f"no (variance inflation {p.variance_inflation:.0f})"
        rows.append(f"| `{p.name}` | {p.value:.3g} | {p.deviation:.2g} | {identified} |")
    one, two = fit.vaf_percent
    return "\n".join([*rows, "", f"Free run over the half that no fit has seen: VAF {one:.1f} % and {two:.1f} %."])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--docs", action="store_true", help="write the table into docs/diagnosis.md")
    options = parser.parse_args()
    line = read(options.recording)
    half = len(line.tension_1) // 2
    text = table(fit_line(line, slice(_SETTLE, half), slice(half, None)))
    print(text)
    if options.docs:
        put(_PAGE, "winding", text)


if __name__ == "__main__":
    main()
