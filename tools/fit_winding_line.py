"""Fit the grey-box model of a winding line to the first half of a recording, and run it freely over the second.

    python tools/fit_winding_line.py winding.csv.gz [--write]

Columns in this order, after the time in s: speeds of unwinder, pacer, rewinder; currents of unwinder and rewinder;
tensions of the two spans. `--write` writes the table, and its summary on the page.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import docs_page
import numpy as np
from winding_line import LineFit, LineRecording, fit_line

#: Rows in which what was before the recording is forgotten.
_SETTLE = 10


def read(path: Path) -> LineRecording:
    """The columns of a CSV file, compressed or not."""
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    if table.ndim != 2 or table.shape[1] != 8 or not np.all(np.isfinite(table)):
        raise SystemExit(f"{path}: expected a header and eight columns of numbers: time, speeds, currents, tensions")
    return LineRecording(float(np.median(np.diff(table[:, 0]))), *table.T[1:])


def rows(fit: LineFit) -> list[list[str]]:
    """Of the table, a row a parameter."""
    return [
        [
            p.name,
            f"{p.value:.3g}",
            f"{p.deviation:.2g}",
            f"{p.variance_inflation:.0f}",
            "yes" if p.is_identified else "no",
        ]
        for p in fit.parameters
    ]


def summary(rows: list[docs_page.Row]) -> str:
    """Which parameters the data identify, and which not."""
    yes = ", ".join(
        f"`{row['parameter']}` {row['value']} ± {row['standard deviation']}" for row in rows if row[BY_ITSELF] == "yes"
    )
    no = ", ".join(f"`{row['parameter']}`" for row in rows if row[BY_ITSELF] == "no")
    return f"Identified by themselves (± standard deviation): {yes}. Not: {no}."


BY_ITSELF = "identified by itself"
TABLE = docs_page.Table(
    "winding_fit",
    "diagnosis_method.md",
    ("parameter", "value", "standard deviation", "variance inflation", BY_ITSELF),
    summary,
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    line = read(options.recording)
    half = len(line.tension_1) // 2
    fit = fit_line(line, slice(_SETTLE, half), slice(half, None))
    one, two = fit.vaf_percent
    free = f"Free run over the half that no fit has seen: VAF {one:.1f} % and {two:.1f} %."
    print(docs_page.markdown(TABLE.columns, rows(fit)), free, sep="\n\n")
    if options.write:
        TABLE.write(rows(fit))
        docs_page.put(docs_page.DOCS / TABLE.page, "winding", free)


if __name__ == "__main__":
    main()
