"""Shaft emulation by a load motor, whole recordings in one compiled call: the rig under its load model.

In each cycle, as on the bench (`hilbench.bench.tasks.load_model` with `hilbench.plant.servo_axis.emulation`): the
motion at SYNC is filtered and predicted over the dead time of the emulation, and the load motor gets the torque with
the next SYNC. Noise and resolution are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import Vector, table_of
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.sampled_shaft import emulation_delay_s
from hilbench.plant.sampling import on_all_cores, samples_per
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.effects import KIND, find
from hilbench.plant.servo_axis.emulation import FILTER_CYCLES, most_rad_s2, steepest_Nm_s_per_rad
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.servo_axis.stability import sampled_shaft
from hilbench.plant.servo_axis.tracking_filter import ORDER, gains, transition
from hilbench.plant.web_line import layout as line
from hilbench.plant.web_line import simulation
from hilbench.plant.web_line.shaft_load import ShaftLoad

_INERTIA = lay.place("inertia_mismatch")
_STEPS = slice(lay.place("inertia_step"), lay.place("inertia_step") + 2 * find("inertia_step").slots)
_FED_FORWARD = slice(lay.place("feed_forward"), lay.place("feed_forward") + 3)


@dataclass(frozen=True)
class ShaftEmulation:
    """Settings of a bench's shaft emulation: its cycle, the assumed rig, and the resolution of set points."""

    #: Emulated part, for messages.
    part: ClassVar[str] = "shaft"

    cycle_s: float
    stand: ServoRigParameters
    #: Resolution of the drive's velocity command, rad/s; None if unknown.
    resolution_rad_s: float | None = None

    def as_taken(self, commands_rad_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Velocity commands (n,), rad/s, rounded to the drive's units."""
        unit = self.resolution_rad_s
        return commands_rad_s if unit is None else np.asarray(np.round(commands_rad_s / unit) * unit)


@dataclass(frozen=True, slots=True)
class EmulatedRun:
    """Values reported by the drive; arrays (B, n), at each SYNC."""

    x_rad: Vector
    v_rad_s: Vector
    tau_Nm: Vector


def simulate_emulated(
    bench: ShaftEmulation,
    model: ServoAxisParameters,
    parameters: Vector,
    commands_rad_s: NDArray[np.float64],
    start: tuple[float, float] = (0.0, 0.0),
) -> EmulatedRun:
    """Simulate recorded velocity commands on the rig, on which a load motor emulates the shaft of a model.

    parameters: (B, P) of the model from `layout.pack`, with effects: they act on the rig itself, as much as they would
    in the model. commands_rad_s (n,): one each cycle. start: position (rad) and speed (rad/s) in the first row. Raises
    ValueError for a cycle that is no multiple of the drive's sample time.
    """
    many = np.atleast_2d(np.ascontiguousarray(parameters))
    believed = lay.pack(bench.stand.axis.model_copy(update={"effects": ()}), bench.stand.load_motor)
    rigs, emulated = _rigs(believed, many), _emulated(many)
    # In steady motion; the motors build up their torques from there.
    states = np.array([lay.new_state(stand, *start) for stand in rigs])
    layout = line.Layout.of(believed)
    inputs = layout.new_inputs()
    layout.motor_inputs(inputs).mode = MotorMode.VELOCITY, MotorMode.TORQUE
    samples = samples_per(bench.cycle_s, believed.item(lay.P_SAMPLE_TIME_S))
    lead_s = emulation_delay_s(sampled_shaft(bench.stand, bench.cycle_s))
    rows = np.ascontiguousarray(commands_rad_s, dtype=np.float64)[:, None]
    out, free = np.empty((len(many), len(rows), layout.output_size)), np.zeros((len(rows), 2))
    forward, gain = transition(bench.cycle_s), gains(bench.cycle_s, FILTER_CYCLES * bench.cycle_s)
    law = lead_s, steepest_Nm_s_per_rad(believed, lead_s), most_rad_s2(bench.stand), bench.cycle_s, 0.0, 0.0

    def run(share: slice) -> None:
        load = ShaftLoad(
            emulated[share], np.zeros(layout.input_size), np.zeros(1), believed, np.zeros(ORDER), np.array(law),
            transition(lead_s), forward, gain,
        )  # fmt: skip
        simulation.simulate(
            rigs[share], states[share], inputs.copy(), layout.new_work(), rows, free, samples,
            out[share].reshape(-1), out.shape[2], simulation.NOTHING, table_of(load),
        )  # fmt: skip

    on_all_cores(run, len(many))
    return EmulatedRun(*(out[..., layout.columns[name].start] for name in ("x_m", "v_m_s", "tau_Nm")))


def _rigs(believed: Vector, many: Vector) -> Vector:
    """Parameters (B, P) of the rig with the models' effects.

    Effects that are a share of an inertia are the shares of the model's: the rig has another.
    """
    rigs = np.tile(believed, (len(many), 1))
    rigs[:, lay.P_EFFECTS] = many[:, lay.P_EFFECTS]
    rigs[:, lay.P_INERTIA] += many[:, _INERTIA] * many[:, lay.P_INERTIA]
    for of_model in (_INERTIA, _STEPS, _FED_FORWARD):
        rigs[:, of_model] = 0.0
    return rigs


def _emulated(many: Vector) -> Vector:
    """Parameters (B, P) of the emulated shafts, without effects on the rig; inertia steps and feed-forward stay."""
    shafts, neutral = many.copy(), many[0].copy()
    line.clear_effects(neutral, KIND)
    shafts[:, lay.P_EFFECTS] = neutral[lay.P_EFFECTS]
    for of_model in (_STEPS, _FED_FORWARD):
        shafts[:, of_model] = many[:, of_model]
    return shafts
