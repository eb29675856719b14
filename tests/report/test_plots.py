"""Pictures on paper: where axes and their names stand."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hilbench.apps.report.chart import Chart, Curve
from hilbench.apps.report.plots import Picture, drawn


@pytest.mark.parametrize(("count", "rows"), [(2, 1), (3, 1), (5, 2)])
def test_axes_beside_each_other_are_three_at_most_and_say_what_they_show_where_rows_are_several(
    count: int, rows: int
) -> None:
    t_s = np.linspace(0.0, 1.0, 50)
    charts = [Chart("tension in N", [Curve("true", t_s, 80.0 + t_s, "#000000")]) for _ in range(count)]
    titles = [f"span {number}" for number in range(1, count + 1)]
    picture = drawn(Picture("zoom1", "Step 1", "", charts), side_by_side=titles)
    svg = picture.svg
    labels = re.findall(r"rotate\(-90 ([\d.]+) ([\d.]+)\)\">tension in N<", svg)
    assert len(labels) == count
    assert len({round(float(y)) for _, y in labels}) == rows
    assert [title for title in titles if f">{title}<" in svg] == (titles if rows > 1 else [])
