"""A servo axis: the speed of the shaft and how it is followed, the estimates of inertia and dry friction, torques."""

from __future__ import annotations

from typing import Final

from hilbench.apps.report.chart import BLUE, BROWN, INK, SKY, VERMILLION, Chart, Curve
from hilbench.apps.report.panel import (
    AVERAGED,
    COMMAND_DASH,
    SMOOTHING_S,
    Compared,
    MachinePanels,
    Panel,
    Row,
    Series,
    ShownRun,
    estimate,
)
from hilbench.runs.figures import ESTIMATE_BAND
from hilbench.topology.servo_axis import FRICTION, INERTIA
from hilbench.topology.signals import Shape

_BAND: Final = f"with a band of ±{100 * ESTIMATE_BAND:g} % (grey)"
_RESIDUAL: Final = Series("tau1_residual_Nm", "residual", BLUE, 0.9)


def _beyond_the_command(run: ShownRun) -> Chart | None:
    if "v1_cmd_rad_s" not in run:
        return None
    off = run.get("v1_rad_s") - run.get("v1_cmd_rad_s")
    return Chart("shaft − command in rad/s", [Curve("off", run.t_s, off, BLUE, 0.8, spread=True)])


def _residual(run: ShownRun) -> Chart | None:
    if "tau1_residual_Nm" not in run:
        return None
    return Chart("residual in N·m", [Curve("residual", run.t_s, run.averaged("tau1_residual_Nm"), BLUE)])


def panels_of(shape: Shape) -> MachinePanels:
    """The panels of a shaft."""
    loads = (Series(f"tau_{name}_Nm", name, BROWN, 0.9) for name in shape.load_motors)
    return MachinePanels(
        (
            Panel(
                "speed",
                "Speed of the shaft",
                "speed",
                "rad/s",
                (Series("v1_rad_s", "shaft", BLUE), Series("v1_cmd_rad_s", "command", INK, 0.8, COMMAND_DASH)),
                needs=("v1_rad_s",),
                caption="Speed of the motor shaft and its command. Below: what the shaft is faster than its command.",
                below=_beyond_the_command,
                limits="speed_rad_s",
                row=Row("speed of the shaft", ".1f", "v1_rad_s"),
                steps=(("speed rms, rad/s", "speed_rms_error_rad_s"),),
                compared=Compared("Speed of the shaft", ("v1_rad_s",)),
            ),
            estimate(
                INERTIA,
                "inertia",
                "Inertia of the shaft",
                f"Inertia of the emulated shaft {_BAND}, and the twin’s estimate with a band of ±2 standard deviations "
                "where the twin states one.",
                Row("inertia", ".2f"),
                steps=(("J in 1 %, s", "J_time_to_1pct_s"), ("noise, %", "J_noise_pct")),
                compared=Compared("Inertia, estimated", (INERTIA.twin_signal,)),
            ),
            estimate(
                FRICTION,
                "friction",
                "Dry friction of the shaft",
                f"Dry friction of the emulated shaft {_BAND}, and the twin’s estimate.",
                Row("dry friction", ".3f"),
                steps=(("friction off, %", "coulomb_final_error_pct"),),
                compared=Compared("Dry friction, estimated", (FRICTION.twin_signal,)),
            ),
            Panel(
                "torques",
                "Torque of the motor",
                "torque",
                "N·m",
                (
                    Series("tau1_Nm", "measured", SKY, 0.7, spread=True),
                    Series("tau1_sim_Nm", "simulated", VERMILLION, 1.0),
                ),
                needs=("tau1_Nm",),
                caption=f"Motor torque: measured and simulated by the twin. Below: their difference, averaged over "
                f"{SMOOTHING_S:g} s; it is what the twin learns inertia and friction from.",
                below=_residual,
                live=False,
                compared=Compared("Torque of the motor, averaged", ("tau1_Nm",), AVERAGED),
            ),
            Panel(
                "torque",
                "Torques",
                "torque",
                "N·m",
                (Series("tau1_Nm", "measured", BLUE, 1.0), Series("tau1_sim_Nm", "simulated", VERMILLION, 1.0), *loads),
                limits="torque_Nm",
            ),
            Panel("residual", "Residual of the torque", "residual", "N·m", (_RESIDUAL,)),
            Panel(
                "load",
                "Torque of the load motor",
                "torque",
                "N·m",
                (
                    Series("tau_load_Nm", "measured", SKY, 0.7, spread=True),
                    Series("tau_load_cmd_Nm", "command", INK, 0.9),
                ),
                least=0.1,
                caption="Torque of the load motor, which emulates the inertia and friction that are not there, and its "
                "command.",
                live=False,
            ),
        )
    )
