"""Signals and quantities: those of a servo axis, the coefficient and the torque of the fan."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.topology import servo_axis
from hilbench.topology.main_quantities.quantity import MainQuantity
from hilbench.topology.quantities import Permitted
from hilbench.topology.servo_axis import *  # noqa: F403  # what is not given below
from hilbench.topology.signal_kinds import SignalKind
from hilbench.topology.signals import Shape

DRAG = MainQuantity(
    path="load.fan.drag_Nm_s2_per_rad2",
    title="coefficient of the emulated fan",
    short="drag",
    unit="N·m·s²/rad²",
    signal="drag_true_Nm_s2_per_rad2",
    key="d",
    emulated=True,
)
SIGNALS = (
    *servo_axis.SIGNALS,
    SignalKind(DRAG.signal, DRAG.unit, DRAG.title, "truth"),
    SignalKind("tau_fan_true_Nm", "N·m", "torque of the emulated fan", "truth"),
)
QUANTITIES = {**servo_axis.QUANTITIES, DRAG.path: Permitted(0.0, 1.0, DRAG.unit)}


def main_quantities(shape: Shape) -> Sequence[MainQuantity]:
    """What a person sets, and sees stepping in a report."""
    return (*servo_axis.main_quantities(shape), DRAG)
