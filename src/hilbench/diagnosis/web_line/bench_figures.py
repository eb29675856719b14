"""Figures of a run of a web line."""

from __future__ import annotations

import numpy as np

from hilbench.diagnosis.live_figure import WORKS, LiveFigure, signal
from hilbench.diagnosis.noise import rms
from hilbench.results.recording import Recording


def figures_of_line(recording: Recording) -> tuple[LiveFigure, ...]:
    """Figures of the one span, or of each of several by its number."""
    if "F_true_N" in recording:
        return _of_a_span(recording, 1, "")
    spans = [span for span in range(1, len(recording.channels)) if f"F{span}_true_N" in recording]
    if any(f"F{span}_sim_N" not in recording for span in spans):
        return _with_stations(recording, [span for span in spans if f"F{span}_sim_N" in recording])
    return tuple(figure for span in spans for figure in _of_a_span(recording, span, str(span)))


def _with_stations(recording: Recording, spans: list[int]) -> tuple[LiveFigure, ...]:
    """Figures of a line of which the twin publishes one span of each section between two axes: `spans`."""
    axes = [axis for axis in range(1, len(recording.channels)) if f"v{axis}_cmd_m_s" in recording]
    speed = signal(recording, f"v{axes[-1]}_cmd_m_s")
    works, figures = speed > WORKS * speed.max(), []
    for axis in axes:
        if f"tau{axis}_residual_Nm" in recording:
            residual_Nm = rms(signal(recording, f"tau{axis}_residual_Nm")[works])
            name = f"torque_residual_axis{axis}_rms_Nm"
            figures.append(LiveFigure(name, f"torque residual of axis {axis}, rms, N·m", residual_Nm))
    for span in spans:
        off_N = signal(recording, f"F{span}_sim_N") - signal(recording, f"F{span}_true_N")
        text = f"simulated less true tension of span {span}, mean, N"
        figures.append(LiveFigure(f"tension{span}_deviation_mean_N", text, float(np.mean(off_N[works]))))
    return tuple(figures)


def _of_a_span(recording: Recording, span: int, number: str) -> tuple[LiveFigure, ...]:
    """`number`: as names have it; "" where there is one span."""
    behind, where = span + 1, f" of span {number}" if number else ""
    speed = signal(recording, f"v{behind}_cmd_m_s")
    works = speed > WORKS * speed.max()
    if f"loop{number}_closed" in recording:
        closed = works & (signal(recording, f"loop{number}_closed") > 0.5)
        works = closed if closed.any() else works
    true_N, sim_N = signal(recording, f"F{number}_true_N"), signal(recording, f"F{number}_sim_N")
    ratio = signal(recording, f"E{number}_sim_Pa") / signal(recording, f"E{number}_true_Pa")
    residual_Nm = signal(recording, f"tau{behind}_residual_Nm")
    behind_it = f" of axis {behind}" if number else ""
    figures = [(f"torque_residual{number}_rms_Nm", f"torque residual{behind_it}, rms, N·m", rms(residual_Nm[works]))]
    if f"F{number}_ref_N" in recording:
        error_N = true_N - signal(recording, f"F{number}_ref_N")
        figures.append(
            (f"tension{number}_error_rms_N", f"true tension less set-point{where}, rms, N", rms(error_N[works]))
        )
    deviation_N = float(np.mean((sim_N - true_N)[works]))
    figures.append((f"tension{number}_deviation_mean_N", f"simulated less true tension{where}, mean, N", deviation_N))
    figures.append((f"E{number}_bias_pct", f"bias of E{where}, %", 100.0 * float(np.mean(ratio[works]) - 1.0)))
    return tuple(LiveFigure(*figure) for figure in figures)
