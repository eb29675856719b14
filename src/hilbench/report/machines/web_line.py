"""A web line: velocities and what mass conservation asks of them, the torque that E is seen by, E, the tension."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.synchronization import reference_estimate
from hilbench.errors import UnusableInputError
from hilbench.report.chart import BLUE, INK, SKY, VERMILLION, Chart, Curve
from hilbench.report.machines.picture import (
    AVERAGED,
    SMOOTHING_S,
    VELOCITY,
    Array,
    ComparedSignal,
    Line,
    MachinePictures,
    RunPicture,
    ShownRun,
    estimate,
    lines,
)
from hilbench.results.recording import Recording
from hilbench.runs.config import load_with_overrides
from hilbench.runs.figures import ESTIMATE_BAND, working_window
from hilbench.runs.machines.web_line import expected_v1_m_s
from hilbench.topology.main_quantities.web_line import MODULUS


def _beyond_the_line(run: ShownRun) -> Chart:
    """A thousand times finer than the velocities: what axis 1 runs faster than the line."""
    v1, v2, steady = run.velocity("x1_m"), run.velocity("x2_m"), _steady(run)
    fine = [Curve("axis 1 − line", run.t_s, np.where(steady, 1e3 * (v1 - v2), np.nan), BLUE)]
    if {"strain_prev", "strain_true"} <= run.recording.channels.keys():
        asked = 1e3 * (expected_v1_m_s(v2, run.get("strain_prev"), run.averaged("strain_true")) - v2)
        fine.append(Curve("mass balance", run.t_s, np.where(steady, asked, np.nan), INK, 0.9, (4, 2)))
    return Chart("v1 − line in mm/s", fine, least=0.05)


def _steady(run: ShownRun) -> NDArray[np.bool_]:
    """Where the line-speed command has not changed for twice the time of the averages."""
    if "v2_cmd_m_s" not in run:
        return np.ones(len(run.recording), bool)
    command = run.get("v2_cmd_m_s")
    top = float(np.max(np.abs(command), initial=0.0, where=np.isfinite(command)))
    moved = np.concatenate(([False], ~(np.abs(np.diff(command)) <= 1e-6 * top)))
    count = np.cumsum(moved)
    before = np.clip(np.arange(len(command)) - 2 * run.width, 0, None)
    return np.asarray(count == count[before])


def _working_velocity(run: ShownRun, position: str) -> Array | None:
    """Velocity of axis 1 minus line speed while the line runs at its working speed."""
    if "x2_m" not in run:
        return None
    difference = np.full(len(run.recording), np.nan)
    part = working_window(run.t_s, run.get("v2_cmd_m_s")) if "v2_cmd_m_s" in run else None
    part = part or slice(None)
    difference[part] = (run.velocity(position) - run.velocity("x2_m"))[part]
    return difference


def _published(config: Path, recording: Recording) -> Array | None:
    """E by the published method; None also for the config of a run that is too old to be understood now."""
    try:
        return reference_estimate(load_with_overrides(config).config, recording)
    except UnusableInputError:
        return None


_PICTURES: Final = (
    RunPicture(
        "velocities",
        "Velocities",
        f"Velocities at the web, averaged over {SMOOTHING_S:g} s, but not over a step or the ends of a ramp. Below: "
        "velocity of axis 1 minus line speed (axis 2), and what mass conservation asks for at the strain of the "
        "imitated web once it is steady.",
        (
            lines(
                "velocity in m/s",
                Line("x2_m", "axis 2", VERMILLION, 2.6, alpha=0.8, values=VELOCITY),
                Line("x1_m", "axis 1", BLUE, 1.3, values=VELOCITY),
                Line("v2_cmd_m_s", "commands", INK, 0.8, (4, 4)),
                Line("v1_cmd_m_s", "", INK, 0.8, (4, 4)),
            ),
            _beyond_the_line,
        ),
        needs=("x1_m", "x2_m"),
    ),
    RunPicture(
        "torques",
        "Torque of axis 2",
        f"Motor torque of axis 2: measured, averaged over {SMOOTHING_S:g} s, and simulated by the twin. Their "
        "difference is what the twin learns E from.",
        (
            lines(
                "torque in N·m",
                Line("tau2_Nm", "measured", SKY, 0.7, spread=True),
                Line("tau2_Nm", "averaged", BLUE, values=AVERAGED),
                Line("tau2_sim_Nm", "simulated", VERMILLION, 1.2),
            ),
        ),
        needs=("tau2_Nm",),
    ),
    RunPicture(
        "elasticity",
        "Young’s modulus",
        f"Young’s modulus of the imitated web with a band of ±{100 * ESTIMATE_BAND:g} % (grey), and the twin’s "
        "estimate with a band of ±2 standard deviations where the twin states one.",
        (estimate(MODULUS, "E_sd_Pa"),),
        with_reference="PID: what the published tracking simulation makes of the same measurements.",
        zoomed=True,
    ),
    RunPicture(
        "tension",
        "Web tension",
        "Tension of the imitated web, tension simulated by the twin (the virtual sensor that the controller sees),"
        " and set-point.",
        (
            lines(
                "tension in N",
                Line("F_true_N", "true", BLUE),
                Line("F_sim_N", "simulated", VERMILLION, 1.2),
                Line("F_ref_N", "set-point", INK, 0.9, (4.0, 2.0)),
                least=4.0,
            ),
        ),
        zoomed=True,
    ),
)

PICTURES: Final = MachinePictures(
    _PICTURES,
    compared=(
        ComparedSignal("elasticity", "Young’s modulus, estimated", "E in N/mm²", ("E_sim_Pa",), 1e6),
        ComparedSignal("tension", "Web tension", "tension in N", ("F_true_N", "F_sim_N")),
        ComparedSignal("torque", "Torque of axis 2, averaged", "torque in N·m", ("tau2_Nm",), values=AVERAGED),
        ComparedSignal(
            "velocity",
            "Velocity of axis 1 minus line speed",
            "v1 − line in mm/s",
            ("x1_m",),
            1e-3,
            values=_working_velocity,
        ),
    ),
    reference=_published,
)
