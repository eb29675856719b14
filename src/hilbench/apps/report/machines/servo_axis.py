"""A servo axis: the speed of the shaft and how it is followed, torques, the estimates of inertia and dry friction."""

from __future__ import annotations

from typing import Final

from hilbench.apps.report.chart import BLUE, INK, SKY, VERMILLION, Chart, Curve
from hilbench.apps.report.machines.picture import (
    AVERAGED,
    SMOOTHING_S,
    ComparedSignal,
    Line,
    MachinePictures,
    RunPicture,
    ShownRun,
    estimate,
    lines,
)
from hilbench.runs.figures import ESTIMATE_BAND
from hilbench.topology.main_quantities.servo_axis import FRICTION, INERTIA
from hilbench.topology.signals import Shape

_BAND: Final = f"with a band of ±{100 * ESTIMATE_BAND:g} % (grey)"


def _beyond_the_command(run: ShownRun) -> Chart | None:
    if "v1_cmd_rad_s" not in run:
        return None
    off = run.get("v1_rad_s") - run.get("v1_cmd_rad_s")
    return Chart("shaft − command in rad/s", [Curve("off", run.t_s, off, BLUE, 0.8, spread=True)])


_PICTURES: Final = (
    RunPicture(
        "speed",
        "Speed of the shaft",
        "Speed of the motor shaft and its command. Below: what the shaft is faster than its command.",
        (
            lines(
                "speed in rad/s",
                Line("v1_rad_s", "shaft", BLUE),
                Line("v1_cmd_rad_s", "command", INK, 0.8, (4, 4)),
            ),
            _beyond_the_command,
        ),
        needs=("v1_rad_s",),
    ),
    RunPicture(
        "torques",
        "Torque of the motor",
        f"Motor torque: measured and simulated by the twin. Below: their difference, averaged over {SMOOTHING_S:g} s; "
        "it is what the twin learns inertia and friction from.",
        (
            lines(
                "torque in N·m",
                Line("tau1_Nm", "measured", SKY, 0.7, spread=True),
                Line("tau1_sim_Nm", "simulated", VERMILLION, 1.0),
            ),
            lines("residual in N·m", Line("tau1_residual_Nm", "residual", BLUE, values=AVERAGED)),
        ),
        needs=("tau1_Nm",),
    ),
    RunPicture(
        "inertia",
        "Inertia of the shaft",
        f"Inertia of the emulated shaft {_BAND}, and the twin’s estimate with a band of ±2 standard deviations where "
        "the twin states one.",
        (estimate(INERTIA),),
        zoomed=True,
    ),
    RunPicture(
        "friction",
        "Dry friction of the shaft",
        f"Dry friction of the emulated shaft {_BAND}, and the twin’s estimate.",
        (estimate(FRICTION),),
        zoomed=True,
    ),
    RunPicture(
        "load",
        "Torque of the load motor",
        "Torque of the load motor, which emulates the inertia and friction that are not there, and its command.",
        (
            lines(
                "torque in N·m",
                Line("tau_load_Nm", "measured", SKY, 0.7, spread=True),
                Line("tau_load_cmd_Nm", "command", INK, 0.9),
                least=0.1,
            ),
        ),
    ),
)

PICTURES: Final = MachinePictures(
    _PICTURES,
    compared=(
        ComparedSignal("inertia", "Inertia, estimated", "J in kg·cm²", ("J_sim_kg_m2",), 1e-4),
        ComparedSignal("friction", "Dry friction, estimated", "friction in N·m", ("coulomb_sim_Nm",)),
        ComparedSignal("torque", "Torque of the motor, averaged", "torque in N·m", ("tau1_Nm",), values=AVERAGED),
        ComparedSignal("speed", "Speed of the shaft", "speed in rad/s", ("v1_rad_s",)),
    ),
)


def pictures_of(shape: Shape) -> MachinePictures:
    """The pictures of a shaft."""
    return PICTURES
