"""The page of a matrix of requirements by runs."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import quote

from hilbench.apps.library.matrix import Matrix
from hilbench.apps.report.page import write_page


def write_matrix_page(matrix: Matrix, base: Path, path: Path) -> Path:
    """Write the page, with links to the reports of the runs in the folder `base`; returns `path`.

    Raises UnusableInputError if it can't be written.
    """
    below = quote(Path(os.path.relpath(base.resolve(), path.resolve().parent)).as_posix())
    links = [f"{below}/{quote(run.path)}/report.html" if run.has_report else "" for run in matrix.runs]
    covered = len(matrix.rows) - len(matrix.not_covered)
    held = sum(row.newest in ("passed", "marginal") for row in matrix.rows)
    return write_page(
        path,
        "library/matrix",
        title="Requirements",
        facts=[f"{len(matrix.rows)} requirements", f"{covered} covered", f"{held} passed when last looked at"],
        passed=matrix.fulfilled,
        runs=list(zip(matrix.runs, links, strict=True)),
        rows=matrix.rows,
    )
