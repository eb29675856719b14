"""Twin of a servo axis: the simulated shaft, and the estimator of its inertia and friction."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf, isnan, nan

from hilbench.estimation.plausibility import Plausibility
from hilbench.estimation.problems import Problem
from hilbench.estimation.servo_axis.balance import ShaftSample
from hilbench.estimation.servo_axis.inertia import COULOMB_SD, VISCOUS_SD, InertiaEstimator, Known, ShaftEstimate
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.fmu.shaft import FmuAxis
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import per_item
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import ServoAxis
from hilbench.plant.web_line.layout import Vector
from hilbench.processes import log
from hilbench.topology.blocks import TwinConfig
from hilbench.topology.signals import Shape
from hilbench.twin.estimated_errors import EstimatedModelError
from hilbench.twin.machines import servo_axis_cycle as cycle
from hilbench.twin.machines.machine import BoundaryInputs, MachineVectors, Measured
from hilbench.twin.machines.servo_axis_cycle import ShaftInVectors

#: Speed above which the plant counts as running when the twin joins.
_MOVES_RAD_S = 0.02
_COULOMB, _VISCOUS = "coulomb_friction_Nm", "viscous_friction_Nm_s_per_rad"


def twin(
    model: ServoAxisParameters, config: TwinConfig, shape: Shape, cycle_s: float, boundary_inputs: BoundaryInputs
) -> ServoAxisTwin:
    """Twin of a servo axis."""
    ports = (MotorPort(),)
    plant = FmuAxis(model, ports, log) if isinstance(model, FmuAxisParameters) else ServoAxis(model, ports)
    return ServoAxisTwin(model, config, cycle_s, plant)


class ServoAxisTwin:
    """`TwinMachine` with one axis. The model gets the estimated inertia and friction in every cycle."""

    refused = False
    torque_shift_Nm = 0.0
    torque_undecided = False

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
    def problems(self) -> Mapping[int, Problem | None]:
        """Reason why the last measurement could not be used, if any."""
        return {0: self.problem}

    def reset(self) -> None:
        """Reset to inertia and friction of the model, at rest."""
        shaft = self._model.shaft
        self._found = {_COULOMB: shaft.coulomb_friction_Nm, _VISCOUS: shaft.viscous_friction_Nm_s_per_rad}
        self._begin()
        self._simulate(self._estimate.inertia_kg_m2)
        self.plant.set_state({"x1_rad": 0.0, "v1_rad_s": 0.0, "tau1_Nm": 0.0})

    def _begin(self) -> None:
        self._estimator = InertiaEstimator(self._config.inertia, self._model)
        self._kept: tuple[Known, ...] = (self._estimator.known(),)
        self._set_cycle(self._cycle_s)
        initial = self._model.inertia_kg_m2 * self.plant.inertia_factor
        self._estimate = ShaftEstimate(initial, 0.01 * self._config.inertia.initial_deviation_pct * initial, False)
        self.problem: Problem | None = None
        self.shift_span = 0
        self._residual_Nm = 0.0

    def _set_cycle(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._plausibility = Plausibility(self._limit_Nm, 0.0, 0.0, cycle_s)
        self._torque_before_Nm: float | None = None  # simulated

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
            {
                "x1_rad": position_rad,
                "v1_rad_s": speed_rad_s if moves else 0.0,
                "tau1_Nm": torque_Nm if moves else 0.0,
            }
        )
        self._torque_before_Nm = None
        self._kept = (self._estimator.known(),)
        return True

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Update the estimator; the model gets its inertia and friction."""
        ((position_rad, torque_Nm),) = measured
        simulated_Nm = self.ports[0].torque_Nm
        self._residual_Nm = torque_Nm - simulated_Nm
        self.problem = self._plausibility.problem(torque_Nm, 1.0, position_rad)
        if self.problem is not None or self._frozen:
            self._torque_before_Nm = None
            self._estimate = self._estimator.hold(self._cycle_s)
            return True
        ripple_Nm = 0.0
        if self._torque_before_Nm is not None:
            ripple_Nm = self.plant.outputs()["tau1_mean_Nm"] - 0.5 * (self._torque_before_Nm + simulated_Nm)
        self._torque_before_Nm = simulated_Nm
        shaft_Nm = torque_Nm - self.other_Nm
        self._estimate = self._estimator.update(ShaftSample(self._cycle_s, position_rad, shaft_Nm, ripple_Nm))
        self._found |= {found.name: found.value for found in self._estimate.also if found.name in self._found}
        self._simulate(self._estimate.inertia_kg_m2)
        # The angle of an unbalance is the encoder's: the simulated drive follows its speed, and drifts.
        self.plant.set_state({"x1_rad": position_rad})
        return True

    def _simulate(self, inertia_kg_m2: float) -> None:
        # The estimate includes the effect of the model's effects on the inertia.
        self.plant.set_parameter("inertia_kg_m2", inertia_kg_m2 / self.plant.inertia_factor)
        for name, value in self._found.items():
            self.plant.set_parameter(name, max(value, 0.0))

    def miss(self) -> None:
        """Skip a cycle without measurement."""
        self._torque_before_Nm = None
        self._estimate = self._estimator.miss(self._cycle_s)

    @property
    def runs_in_vectors(self) -> bool:
        """True if `in_vectors` covers all of a cycle: not with a plant whose steps are other code."""
        return type(self.plant) is ServoAxis

    def warm_up_in_vectors(self) -> None:
        """Compile, or load, the functions for running in vectors."""
        cycle.warm_up()

    def in_vectors(self, vectors: MachineVectors, fallback: Callable[[int], bool]) -> ShaftInVectors:
        """Runner in vectors; see `VectorMachine`."""
        before_Nm = nan if self._torque_before_Nm is None else self._torque_before_Nm
        estimates = {
            cycle.RESIDUAL_NM: self._residual_Nm,
            cycle.BEFORE_NM: before_Nm,
            cycle.PROBLEM: float(self.problem or 0),
            cycle.COULOMB: self._found[_COULOMB],
            cycle.VISCOUS: self._found[_VISCOUS],
        }
        return ShaftInVectors(
            self._estimator,
            self._plausibility,
            self.plant,
            self._cycle_s,
            0.01 * self._config.synchronized_pct,
            estimates,
            self._take_over,
            vectors,
            fallback,
        )

    def _take_over(self, estimates: Vector) -> None:
        """Take over the outputs of the vectors."""
        self._estimate, self.problem = self._estimator.estimate, cycle.problem_of(estimates)
        self._residual_Nm, before_Nm = estimates.item(cycle.RESIDUAL_NM), estimates.item(cycle.BEFORE_NM)
        self._torque_before_Nm = None if isnan(before_Nm) else before_Nm
        self._found = {_COULOMB: estimates.item(cycle.COULOMB), _VISCOUS: estimates.item(cycle.VISCOUS)}

    def listen(self) -> None:
        """No-op: a shaft has no boundary inputs."""

    def found(self) -> Sequence[EstimatedModelError]:
        """Empty: no model errors are estimated."""
        return ()

    def use_method(self, number: int) -> None:
        """Raise ValueError for other than 0: there is one method."""
        if number:
            raise ValueError(f"method {number}, expected 0: a servo axis has the configured one")

    #: See `TwinMachine`.
    largest_steps: Sequence[float] = ()

    def published(self) -> tuple[float, ...]:
        """Inertia, dry friction, deviation of the inertia, simulated torque, its residual; deviation of the dry
        friction, viscous friction, its deviation."""
        found, stated = self._estimate, self._estimator.stated
        return (
            found.inertia_kg_m2,
            self._found[_COULOMB],
            found.deviation_kg_m2,
            self.ports[0].torque_Nm,
            self._residual_Nm,
            stated.item(COULOMB_SD),
            self._found[_VISCOUS],
            stated.item(VISCOUS_SD),
        )
