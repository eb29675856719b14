"""The pages of comparison, synchronizers and diagnosis: complete, self-contained, and escaped like the report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.report.parsed import EVIL, parsed

from hilbench.apps.compare.page import ComparedRun, write_compare_page
from hilbench.apps.diagnose.diagnose import Found, write_diagnosis_page
from hilbench.apps.report import page as report_page
from hilbench.apps.report.panel import ShownRun
from hilbench.apps.sync.compare import write_comparison
from hilbench.diagnosis.diagnosis import Diagnosis, Gap, GapLocation, NamedEffect, Profile, Unobservable, Value
from hilbench.diagnosis.residual_analysis import Misfit
from hilbench.diagnosis.web_line_bench_gap import LiveFigure, LiveGap
from hilbench.errors import UnusableInputError
from hilbench.estimation.web_line.offline import Track
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording
from hilbench.results.web_line_synchronization import Comparison, MethodResult

T_S = np.linspace(0.0, 10.0, 2000)


def compared(path: Path) -> Path:
    recording = Recording({"t_s": T_S, "F_true_N": 80.0 + np.sin(T_S)})
    values = [{f"noise{EVIL}": 1.5}, {f"noise{EVIL}": 2.25}]
    runs = [ComparedRun(f"run {EVIL}", ShownRun(recording), metrics, "passed") for metrics in values]
    return write_compare_page(runs, path)


def synchronized(path: Path) -> Path:
    E_Pa, sd_Pa, zeros = (np.full(len(T_S), value) for value in (8.7e9, 3e7, 0.0))
    track = Track(E_Pa, sd_Pa, zeros, zeros, {}, None)
    result = MethodResult("pid", track, 1.0, 2.0, None, 0.1, 0.2, 0.95, 12.0)
    comparison = Comparison(T_S, None, None, 0.05, np.full(len(T_S), 1e7), 0.1, [result])
    return write_comparison(comparison, f"sync {EVIL}", path.parent)


def diagnosis() -> Diagnosis:
    rising = np.arange(4.0)
    zeros = np.zeros((1, len(T_S)))
    return Diagnosis(
        "named",
        [NamedEffect(f"friction{EVIL}", 1, {f"force{EVIL}": Value(1.25, (1.0, 1.5), "N")}, {}, ["other"], EVIL)],
        [Gap(f"tau1{EVIL}", 1.0, 0.2, 0.1, "N·m")],
        [GapLocation("tau1_Nm", EVIL, EVIL, 0.25)],
        [Profile("tau1_Nm", "v1", "m/s", rising, rising, rising)],
        [Misfit("tau1_Nm", EVIL, EVIL, 3.5, 1.0, "always")],
        [Unobservable("backlash", 2, None, "m", EVIL)],
        [],
        ModelParameters.model_construct(),
        ("tau1_Nm",),
        T_S,
        zeros + 1.0,
        zeros,
        T_S > 5.0,
        12,
    )


def diagnosed(path: Path) -> Path:
    gaps = [LiveGap(Path("run"), 3, (LiveFigure("torque_residual_rms_Nm", "torque residual, rms, N·m", 1.0),))]
    found = Found(diagnosis(), None, gaps, f"why {EVIL}")
    return write_diagnosis_page(found, f"title {EVIL}", path, Path("bench<b>.yaml"))


@pytest.mark.parametrize(("write", "times"), [(compared, 3), (synchronized, 1), (diagnosed, 10)])
def test_names_from_files_are_text_and_run_nothing(write, times: int, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    path = write(tmp_path / "page.html")
    page = parsed(path)
    assert EVIL not in path.read_text(encoding="utf-8")
    assert page.text.count(EVIL) >= times
    assert tuple(page.scripts[1:]) == report_page.scripts()
    assert not {"link", "img", "iframe", "object"} & set(page.tags)


def test_a_diagnosis_says_what_was_found_and_how_to_use_it(tmp_path: Path) -> None:
    text = parsed(diagnosed(tmp_path / "page.html")).text
    order = [text.index(f"\n{title}\n") for title in ("Effects", "Gap", "Residuals", "The twin on the bench")]
    assert order == sorted(order)
    for wanted in ("1.25", "1 to 1.5", "25 %", "never", "hilbench run bench<b>.yaml", "backlash of axis 2"):
        assert wanted in text


def test_a_diagnosis_without_a_finding_leaves_its_sections_out(tmp_path: Path) -> None:
    nothing = replace(
        diagnosis(), verdict="complete", effects=[], where=[], profiles=[], unexplained=[], unobservable=[]
    )
    text = parsed(write_diagnosis_page(Found(nothing, None), "title", tmp_path / "page.html", None)).text
    assert "Nothing is missing that these data can show." in text
    for absent in ("Effects", "Where the model disagreed", "Not explained", "The twin on the bench", "in use"):
        assert absent not in text


@pytest.mark.parametrize("write", [compared, synchronized, diagnosed])
def test_a_page_that_cannot_be_written_is_one_line(write, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(
        UnusableInputError, match=r"(page\.html|estimates\.csv): cannot be written \(No such file or directory\)"
    ):
        write(tmp_path / "no" / "page.html")
