"""The load-model task: the machine that the load motors emulate, from the measured motion of the axes.

Torque emulation: a load motor applies the machine's torque on the shaft; inertia that is there stays real (the
stand's flywheel), because emulating an inertia by torque over a sampled bus is stable only below the real one
(`hilbench.plant.sampled_shaft`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Vector
from hilbench.bench.tasks.task import MANY, CompiledStages, CyclicTask, Outputs
from hilbench.cycle_program import CompiledStage
from hilbench.plant.effect import MachineKind
from hilbench.plant.effects import find_effect
from hilbench.plant.interface import Follower
from hilbench.plant.measured_motion import FollowsInStep, HasFollowed, MeasuredMotion
from hilbench.plant.parameters import EffectEntry
from hilbench.topology.quantities import EffectPath, is_simple_path, parse_effect_path
from hilbench.topology.sample import CycleSample

Places = NDArray[np.int64]


class LoadModel:
    """Emulated machine on measured motion → torque set points of the load motors (N·m at their shafts).

    The torque acts later than the motion was measured (by `lead_s`), so the machine is predicted over that delay:
    without it the loop of web and sampled shaft is unstable on the demonstrator (`hilbench.plant.web_line.stability`).
    While samples are late, or their positions not of one instant, the torques stay; the machine then follows over the
    time actually elapsed, and the age of the new sample is predicted over as well. (To predict over a missing
    sample, from the noise of the last one, does more harm than to hold.) The elapsed time
    is found from travel and speed, where the axes turn: no frame reports that a drive has missed a SYNC, or that the
    bench has sent one late.

    `load_axes`: axis, from 1, of each load motor's shaft; `least_travel`, in the machine's unit of
    position: least travel by which cycles can be counted; `effects`: those of the machine at the start;
    `own_play`: as `MeasuredMotion`, of a machine whose axes turn at speeds of their own.
    """

    def __init__(
        self,
        machine: Follower,
        load_axes: Sequence[int],
        cycle_s: float,
        lead_s: float,
        least_travel: float,
        effects: Iterable[EffectEntry] = (),
        own_play: float | None = None,
    ) -> None:
        self.machine = machine
        description = machine.describe()
        self._kind = MachineKind(description.kind)
        self._names = [quantity.name for quantity in description.outputs]
        self._load_axes = tuple(load_axes)
        self._running = False
        counted = self._load_axes[0] - 1 if self._load_axes else 0
        self._motion = MeasuredMotion(description.axes, counted, cycle_s, lead_s, least_travel, own_play)
        self._in_step = machine.in_step(self._motion, self._load_axes) if isinstance(machine, FollowsInStep) else None
        self._torques_Nm = [0.0] * len(self._load_axes)
        self._is_ahead = False  # `_in_step`, of these torques
        self._effects = {(entry.effect, entry.axis, entry.section): dict(entry.parameters) for entry in effects}

    def warm_up(self) -> None:
        """Compile (or load from the cache) what each cycle runs, before one has to wait for it."""
        at_rest = [0.0] * self.machine.describe().axes
        self.update(at_rest, at_rest)
        self.follow_in(np.zeros(2 * len(at_rest)), np.arange(2 * len(at_rest)), late=True)
        self.update(at_rest, at_rest)
        self.machine.outputs()
        self.stop()

    def stop(self) -> None:
        """Drives are off: no torque; the machine is as at the start when it runs again."""
        self._running = False

    def update(self, positions: Sequence[float], speeds: Sequence[float], *, late: bool = False) -> list[float]:
        """Follow the motion since the last cycle; returns the torque of each load motor in N·m.

        `positions` (N,) and `speeds` (N,) are measured ones of the driven axes, in the machine's unit; `late`: one of
        them is of an earlier cycle.
        """
        if not self._running:
            self.machine.reset(positions)
            self._motion.begin(positions, speeds)
            self._running = True
        else:
            if self._is_ahead and self._in_step is not None:
                self._torques_Nm, self._is_ahead = self._in_step.torques_Nm, False
            duration_s = self._motion.elapsed_s(positions, speeds, late=late)
            if not duration_s > 0.0:
                return self._torques_Nm
            self.machine.follow(positions, duration_s)
        self._torques_Nm = self.machine.load_torques_Nm(self._load_axes, speeds, self._motion.ahead_s)
        return self._torques_Nm

    def follow_in(self, values: Vector, places: Places, *, late: bool) -> HasFollowed | None:
        """Follow in one call on a sample's vector, with its outputs (`hilbench.plant.measured_motion.InStep`). None,
        and nothing done, where this machine can't follow so in its present state."""
        if not self._running or self._in_step is None or not self._in_step.usable:
            return None
        followed = self._in_step.follow(values, places, late=late)
        self._is_ahead = self._is_ahead or followed is not HasFollowed.NOT
        return followed

    def piece(self, values: Vector, places: Places, fallback: Callable[[HasFollowed], bool]) -> CompiledStage | None:
        """`follow_in` as a compiled stage, while `continues` is true; None for a machine that can't follow so."""
        in_step = self._in_step
        if in_step is None:
            return None
        return in_step.piece(values, places, lambda code: fallback(in_step.has_followed(code)))

    @property
    def continues(self) -> bool:
        """True if the machine follows in one call, and nothing was changed since it did so last."""
        in_step = self._in_step
        return self._running and self._is_ahead and in_step is not None and in_step.usable and in_step.is_shown

    @property
    def held_s(self) -> float:
        """Time for which the torques have been held, as samples are late or their positions not of one instant."""
        return self._motion.unfollowed_s

    def outputs(self) -> Sequence[float]:
        """The truth after a cycle, in the order of the machine's description."""
        true = self.machine.outputs()
        return [true[name] for name in self._names]

    def set_value(self, name: str, value: float) -> None:
        """Set an input of the machine, from the present state on. Raises ValueError for an unknown one."""
        self.machine.set_input(name, value)

    def owns(self, path: str) -> bool:
        """True if a quantity is one of the emulated mechanics."""
        return path.startswith("load.")

    def value(self, path: str) -> float:
        """Present value of a quantity of the emulated mechanics. Raises ValueError for an unknown path."""
        if is_simple_path(path):
            return self.machine.parameter(_parameter(path))
        effect = parse_effect_path(path, self._kind)
        return self._effect_values(effect)[effect.parameter]

    def set(self, path: str, value: float) -> None:
        """Give a quantity a value from now on. Raises ValueError for an unknown path or an impossible value."""
        if is_simple_path(path):
            self.machine.set_parameter(_parameter(path), value)
        else:
            self._set_effect_value(parse_effect_path(path, self._kind), value)

    def _effect_values(self, path: EffectPath) -> dict[str, float]:
        """All parameters of an effect; one that was given without a section is in each of them."""
        of_all = self._effects.get((path.effect, path.axis, None), {})
        given = self._effects.get((path.effect, path.axis, path.section), of_all)
        return find_effect(path.effect, self._kind).filled(given)

    def _set_effect_value(self, path: EffectPath, value: float) -> None:
        parameters = self._effect_values(path)
        parameters[path.parameter] = value
        self.machine.set_effect(path.effect, path.axis, section=path.section, slot=0, **parameters)
        if path.section is None:  # everywhere, whatever there was
            self._effects = {key: known for key, known in self._effects.items() if key[:2] != (path.effect, path.axis)}
        self._effects[path.effect, path.axis, path.section] = parameters


def _parameter(path: str) -> str:
    """Name of the machine's parameter in a path such as ``load.web.youngs_modulus_Pa``: the part after two words."""
    return path.split(".", 2)[2]


class LoadTask(CyclicTask):
    """Task of load motors, by their names; a kind of machine defines in `after` the motion that its model follows."""

    def __init__(self, motors: Sequence[str], model: LoadModel) -> None:
        self.model = model
        self._commands = [(motor, f"tau_{motor}_cmd_Nm") for motor in motors]

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """The torques that follow from the last sample, N·m at the load motors' shafts."""
        for motor, command in self._commands:
            outputs[motor] = getattr(sample, command)

    def follow(self, sample: CycleSample, positions: Sequence[float], speeds: Sequence[float], *, late: bool) -> None:
        """Let the model follow the measured motion (N,) of the axes, in the machine's unit; record its torques."""
        torques_Nm = self.model.update(positions, speeds, late=late)
        for (_, command), torque_Nm in zip(self._commands, torques_Nm, strict=True):
            setattr(sample, command, torque_Nm)

    def _follows(
        self, sample: CycleSample, places: Places, fallback: Callable[[HasFollowed], bool], *further: CompiledStage
    ) -> CompiledStages | None:
        """Compiled stage that follows the measured motion, and further ones; None where the model can't follow so."""
        piece = self.model.piece(sample.reals, places, fallback)
        if piece is None:
            return None
        return CompiledStages(
            after=[piece, *further], cycles=lambda: MANY if self.model.continues else 0, shown=dict(self._commands)
        )

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Command zero torque."""
        self.model.stop()
