"""A servo axis: its signals, quantities and process data (part `topology` of a kind of machine)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

from hilbench.topology import quantities
from hilbench.topology.main_quantities.quantity import MainQuantity
from hilbench.topology.process_data.table import INPUTS, QUALITY_EVERY, IoPdo, IoSignal, ProcessData, SimulatedTorque
from hilbench.topology.quantities import SHAFT_COULOMB_FRICTION, SHAFT_INERTIA, SHAFT_VISCOUS_FRICTION, Permitted
from hilbench.topology.signal_kinds import (
    BUS_SIGNALS,
    TIME_SIGNALS,
    Per,
    SignalKind,
    axes_signals,
    load_motor_signals,
    twin_signals,
)
from hilbench.topology.signals import Shape

if TYPE_CHECKING:
    from hilbench.topology.config import BenchConfig

SIGNALS: Final = (
    *TIME_SIGNALS,
    *axes_signals("rad", ", at the motor shaft", "the motor shaft of axis {axis}"),
    *load_motor_signals("rad", "its shaft"),
    SignalKind("J_sim_kg_m2", "kg·m²", "inertia of the shaft estimated by the twin", "twin"),
    SignalKind("J_sd_kg_m2", "kg·m²", "standard deviation of the inertia, as the twin states it", "twin"),
    SignalKind("coulomb_sim_Nm", "N·m", "dry friction of the shaft estimated by the twin", "twin"),
    SignalKind("coulomb_sd_Nm", "N·m", "standard deviation of the dry friction; 0 where it is the model's", "twin"),
    SignalKind("viscous_sim_Nm_s_per_rad", "N·m·s/rad", "viscous friction of the shaft estimated by the twin", "twin"),
    SignalKind(
        "viscous_sd_Nm_s_per_rad",
        "N·m·s/rad",
        "standard deviation of the viscous friction; 0 where it is the model's",
        "twin",
    ),
    *twin_signals("{axis}", Per.AXIS),
    SignalKind("J_true_kg_m2", "kg·m²", "inertia of the emulated shaft", "truth"),
    SignalKind("coulomb_true_Nm", "N·m", "dry friction of the emulated shaft", "truth"),
    *BUS_SIGNALS,
)
SMALLEST: Final = Shape(1, ("load",))
QUANTITIES: Final = {
    quantities.SPEED: Permitted(-1e4, 1e4, "rad/s"),
    SHAFT_INERTIA: Permitted(1e-9, 1e6, "kg·m²"),
    SHAFT_COULOMB_FRICTION: Permitted(0.0, 1e5, "N·m"),
    SHAFT_VISCOUS_FRICTION: Permitted(0.0, 1e5, "N·m·s/rad"),
}
SPEED: Final = MainQuantity(quantities.SPEED, "speed of the shaft", "speed", "rad/s", "v1_cmd_rad_s", "v")
INERTIA: Final = MainQuantity(
    SHAFT_INERTIA,
    "inertia of the emulated shaft",
    "J",
    "kg·m²",
    "J_true_kg_m2",
    "m",
    "J_sim_kg_m2",
    "J_sd_kg_m2",
    shown_unit="kg·cm²",
    si_per_shown=1e-4,
    emulated=True,
)
FRICTION: Final = MainQuantity(
    SHAFT_COULOMB_FRICTION,
    "dry friction of the emulated shaft",
    "friction",
    "N·m",
    "coulomb_true_Nm",
    "f",
    "coulomb_sim_Nm",
    emulated=True,
)
METHODS: Final = ()
TWIN_KEYS: Final = frozenset({"node", "synchronized_pct", "behind", "virtual_tpdo_every", "inertia"})


def main_quantities(shape: Shape) -> tuple[MainQuantity, ...]:
    """Quantities of any servo axis."""
    return INERTIA, FRICTION, SPEED


def process_data(shape: Shape) -> ProcessData:
    """Process data of any servo axis."""
    published = inertia, friction, deviation, torque, residual, friction_sd, viscous, viscous_sd = tuple(
        IoSignal(name, INPUTS, sub, text)
        for sub, (name, text) in enumerate(
            (
                ("J_sim_kg_m2", "Estimated inertia of the shaft [kg m2]"),
                ("coulomb_sim_Nm", "Estimated dry friction of the shaft [N m]"),
                ("J_sd_kg_m2", "Standard deviation of the estimated inertia [kg m2]"),
                ("tau1_sim_Nm", "Simulated torque of axis 1 [N m]"),
                ("tau1_residual_Nm", "Torque residual of axis 1 [N m]"),
                ("coulomb_sd_Nm", "Standard deviation of the estimated dry friction [N m]"),
                ("viscous_sim_Nm_s_per_rad", "Estimated viscous friction of the shaft [N m s/rad]"),
                ("viscous_sd_Nm_s_per_rad", "Standard deviation of the estimated viscous friction [N m s/rad]"),
            ),
            1,
        )
    )
    return ProcessData(
        published=published,
        boundary_inputs=(),
        sent=(
            IoPdo(1, (inertia, friction)),
            IoPdo(2, (deviation, residual), QUALITY_EVERY),
            IoPdo(4, (viscous, viscous_sd), QUALITY_EVERY),
            IoPdo(5, (friction_sd,), QUALITY_EVERY),
        ),
        torques=(SimulatedTorque(1, torque.name, residual.name),),
    )


def boundary(machine: Any, shape: Shape) -> Mapping[str, float]:
    """No boundary inputs."""
    return {}


def shape(config: BenchConfig) -> Shape:
    """Shape of the bench: as many axes as the machine has."""
    return Shape(config.machine.axis_count, tuple(config.load_motors))


def build(config: BenchConfig) -> None:
    """Build hardware and emulated machine. Raises ValueError for what can't be built."""
    config.emulated_shaft()
    config.servo_rig_parameters()


def misfits(key: str, value: Any, machine: Any) -> Iterator[str]:
    """Why the value of a key can't be that of a bench with one shaft."""
    if key == "load_motors" and len(value) != 1:
        yield "one load motor: a servo axis has one shaft"
    if key == "controllers" and value:
        yield "none: a servo axis follows its reference"
    if key == "load" and value.web != type(value.web)():
        yield "'shaft:' for a servo axis"


def whole_misfits(config: BenchConfig) -> Iterator[str]:
    """Why a bench with one shaft can't have all that it has together."""
    if config.machine.drives is None:
        yield "a machine with 'drives:'"
    elif config.load.measured:
        yield "no 'load.measured' on a servo axis, whose encoder is measured anyway"
