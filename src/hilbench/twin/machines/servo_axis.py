"""Twin of a servo axis: the simulated shaft, and the estimator of its inertia and friction."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf, isnan, nan
from typing import Final

import numpy as np

from hilbench.cycle_program import CompiledStage
from hilbench.estimation.plausibility import Plausibility
from hilbench.estimation.problems import PROBLEMS, Problem
from hilbench.estimation.servo_axis.balance import ShaftSample
from hilbench.estimation.servo_axis.inertia import InertiaEstimator, Known, ShaftEstimate
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.fmu.shaft import FmuAxis
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import per_item
from hilbench.plant.sensor_rows import silence
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import ServoAxis
from hilbench.plant.web_line.rig_cycle import NoisyRig, RigArrays
from hilbench.processes import log
from hilbench.topology.blocks import TwinConfig
from hilbench.topology.signals import Shape
from hilbench.twin.machines import servo_axis_cycle as cycle
from hilbench.twin.machines.machine import LOOK, WENT_ON, BoundaryInputs, MachineVectors, Measured, OneMethod

#: Speed above which the plant counts as running when the twin joins.
_MOVES_RAD_S = 0.02
#: Outputs by the names of estimates and parameters.
_SHOWN: Final = {"coulomb_friction_Nm": "coulomb_Nm", "viscous_friction_Nm_s_per_rad": "viscous_Nm_s_per_rad"}


def twin(
    model: ServoAxisParameters, config: TwinConfig, shape: Shape, cycle_s: float, boundary_inputs: BoundaryInputs
) -> ServoAxisTwin:
    """Twin of a servo axis."""
    ports = (MotorPort(),)
    plant = FmuAxis(model, ports, log) if isinstance(model, FmuAxisParameters) else ServoAxis(model, ports)
    return ServoAxisTwin(model, config, cycle_s, plant)


class ServoAxisTwin(OneMethod):
    """`TwinMachine` with one axis. The model gets the estimated inertia and friction in every cycle."""

    compiled_cycle = staticmethod(cycle.run)

    def __init__(self, model: ServoAxisParameters, config: TwinConfig, cycle_s: float, plant: ServoAxis) -> None:
        """`plant`: closed model of `model`, with one port."""
        self.ports, self.plant = plant.ports, plant
        self._model = model
        self._config = config
        self._cycle_s, self._frozen = cycle_s, False
        self._limit_Nm = per_item(model.drives.torque_limit_Nm, 1) if model.drives else inf
        self.reset()

    @property
    def other_Nm(self) -> float:
        """Torque that the plant takes beside inertia and friction, which the estimator is not shown."""
        return 0.0

    @property
    def synchronized(self) -> bool:
        """True if the inertia is known as configured."""
        found = self._estimate
        return (
            self.problem is None and found.deviation_kg_m2 <= 0.01 * self._config.synchronized_pct * found.inertia_kg_m2
        )

    @property
    def separable(self) -> bool:
        """True if the inertia is identified by the motion."""
        return self._estimate.separable

    @property
    def problem(self) -> Problem | None:
        """Reason why the last measurement could not be used, if any."""
        return PROBLEMS[int(self._shows["problem"])]

    @property
    def problems(self) -> Mapping[int, Problem | None]:
        """Reason why the last measurement could not be used, if any."""
        return {0: self.problem}

    def reset(self) -> None:
        """Reset to inertia and friction of the model, at rest."""
        shaft = self._model.shaft
        friction = nan, 0.0, shaft.coulomb_friction_Nm, shaft.viscous_friction_Nm_s_per_rad
        self._outputs = np.array([(0.0, *friction, 0.0, 0.0)], cycle.OUTPUTS)
        self._shows = self._outputs[0]
        self._begin()
        self._simulate(self._estimate.inertia_kg_m2)
        self.plant.set_state({"x1_rad": 0.0, "v1_rad_s": 0.0, "tau1_Nm": 0.0})

    def _begin(self) -> None:
        self._estimator = InertiaEstimator(self._config.inertia, self._model)
        self._kept: tuple[Known, ...] = (self._estimator.known(),)
        self._set_cycle(self._cycle_s)
        initial = self._model.inertia_kg_m2 * self.plant.inertia_factor
        self._estimate = ShaftEstimate(initial, 0.01 * self._config.inertia.initial_deviation_pct * initial, False)

    def _set_cycle(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._plausibility = Plausibility(self._limit_Nm, 0.0, 0.0, cycle_s)
        self._estimator.set_cycle_time(cycle_s)
        self._shows["before_Nm"] = nan

    def freeze_adaptation(self, *, frozen: bool) -> None:
        """Freeze parameter adaptation; see `TwinMachine`."""
        self._frozen = frozen

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time; see `TwinMachine`."""
        self.plant.lock_to(cycle_s)
        self._set_cycle(cycle_s)
        self._estimate = self._estimator.go_back(self._kept[0])

    def keep(self) -> None:
        """Take a checkpoint, for `set_cycle_time`."""
        self._kept = self._kept[-1], self._estimator.known()

    def release(self, before: Sequence[Measured], now: Sequence[Measured], *, in_motion: bool = False) -> bool:
        """Release the shaft at the real one's position."""
        ((then_rad, _),), ((position_rad, torque_Nm),) = before, now
        speed_rad_s = (position_rad - then_rad) / self._cycle_s
        moves = abs(speed_rad_s) > _MOVES_RAD_S
        self.plant.set_state(
            {"x1_rad": position_rad, "v1_rad_s": speed_rad_s if moves else 0.0, "tau1_Nm": torque_Nm if moves else 0.0}
        )
        self._shows["before_Nm"] = nan
        self._kept = (self._estimator.known(),)
        return True

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Update the estimator; the model gets its inertia and friction."""
        ((position_rad, torque_Nm),) = measured
        simulated_Nm, shows = self.ports[0].torque_Nm, self._shows
        shows["residual_Nm"] = torque_Nm - simulated_Nm
        shows["problem"] = self._plausibility.problem(torque_Nm, 1.0, position_rad) or 0
        if self.problem is not None or self._frozen:
            shows["before_Nm"] = nan
            self._estimate = self._estimator.hold(self._cycle_s)
            return True
        ripple_Nm, before_Nm = 0.0, float(shows["before_Nm"])
        if not isnan(before_Nm):
            ripple_Nm = self.plant.outputs()["tau1_mean_Nm"] - 0.5 * (before_Nm + simulated_Nm)
        shows["before_Nm"] = simulated_Nm
        shaft_Nm = torque_Nm - self.other_Nm
        self._estimate = self._estimator.update(ShaftSample(self._cycle_s, position_rad, shaft_Nm, ripple_Nm))
        for found in self._estimate.also:
            if found.name in _SHOWN:
                shows[_SHOWN[found.name]] = found.value
        self._simulate(self._estimate.inertia_kg_m2)
        # The angle of an unbalance is the encoder's: the simulated drive follows its speed, and drifts.
        self.plant.set_state({"x1_rad": position_rad})
        return True

    def _simulate(self, inertia_kg_m2: float) -> None:
        # The estimate includes the effect of the model's effects on the inertia.
        self.plant.set_parameter("inertia_kg_m2", inertia_kg_m2 / self.plant.inertia_factor)
        for name, shown in _SHOWN.items():
            self.plant.set_parameter(name, max(float(self._shows[shown]), 0.0))

    def miss(self) -> None:
        """Skip a cycle without measurement."""
        self._shows["before_Nm"] = nan
        self._estimate = self._estimator.miss(self._cycle_s)

    @property
    def runs_in_vectors(self) -> bool:
        """True if `in_vectors` covers all of a cycle: not of a subclass, nor of a plant whose steps are other code."""
        return (type(self), type(self.plant)) == (ServoAxisTwin, ServoAxis)

    def in_vectors(self, vectors: MachineVectors, fallback: Callable[[int], bool]) -> ServoAxisTwin:
        """Go on in these vectors until `give`; see `VectorMachine`."""
        plant, step = self.plant, self.plant.step_in_vectors(self._cycle_s)
        known = 0.01 * self._config.synchronized_pct
        rig = RigArrays(plant.vectors, step.motors, vectors.asked, step.sensors, vectors.shown)
        shaft = cycle.ShaftArrays(
            NoisyRig(rig, *silence(len(step.motors))),
            np.array([(self._cycle_s, step.samples, known)], cycle.FIGURES),
            *(self._outputs, vectors.measured, vectors.values, vectors.whole),
            np.array([(vectors.number, vectors.status)], cycle.AT),
            np.array(vectors.published, np.int64).view(cycle.PUBLISHED),
            self._plausibility.state,
            self._estimator.arrays,
        )
        #: See `machine.InVectors`.
        self.piece = CompiledStage(cycle.run, 0, shaft, continues=WENT_ON, fallback=fallback)
        return self

    def go_on_from(self, code: int) -> int:
        """Look at a problem that begins, lasts or ends; see `machine.InVectors`."""
        if code == LOOK:
            self._estimate = self._estimator.estimate
        return code

    def give(self) -> int:
        """Write back to the objects; see `machine.InVectors`."""
        self._estimate = self._estimator.estimate
        return int(self._shows["status"])

    def listen(self) -> None:
        """No-op: a shaft has no boundary inputs."""

    def published(self) -> tuple[float, ...]:
        """Inertia, dry friction, deviation of the inertia, simulated torque, its residual; deviation of the dry
        friction, viscous friction, its deviation."""
        found, stated, shows = self._estimate, self._estimator.stated, self._shows
        return (
            found.inertia_kg_m2,
            float(shows["coulomb_Nm"]),
            found.deviation_kg_m2,
            self.ports[0].torque_Nm,
            float(shows["residual_Nm"]),
            float(stated["coulomb_sd"]),
            float(shows["viscous_Nm_s_per_rad"]),
            float(stated["viscous_sd"]),
        )
