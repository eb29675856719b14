"""The fan as it is simulated, emulated by a load motor, shown and diagnosed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from hilbench.apps.report.chart import BLUE
from hilbench.apps.report.machines import servo_axis as report
from hilbench.apps.report.panel import MachinePanels, Panel, Series
from hilbench.bench.machines import servo_axis as bench
from hilbench.bench.machines.machine import MachineTasks
from hilbench.bench.state import BenchState
from hilbench.diagnosis import servo_axis as diagnosed
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.predictor import Choice
from hilbench.diagnosis.servo_axis import *  # noqa: F403  # what is not given below
from hilbench.exchange.exchange import Inputs
from hilbench.plant.interface import PlantDescription, Quantity
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.servo_axis.emulation import EmulatedShaft
from hilbench.plant.servo_axis.parameters import ServoRigParameters
from hilbench.plant.servo_axis.shaft import ServoAxis
from hilbench.runs import servo_axis_check
from hilbench.runs.config import ExperimentConfig
from hilbench.runs.machines.machine import MachineMetrics
from hilbench.runs.machines.servo_axis import METRICS
from hilbench.runs.segment import Metric
from hilbench.topology.blocks import TwinConfig
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import Shape
from hilbench.twin.machines.machine import BoundaryInputs
from hilbench.twin.machines.servo_axis import ServoAxisTwin
from hilbench_fan import FanParameters
from hilbench_fan.topology import DRAG

_TORQUE = "tau_fan_true_Nm"
_DRAG = DRAG.path.rpartition(".")[2]


class Fan(ServoAxis):
    """Closed model: drive, shaft and fan."""

    def step(self, duration_s: float) -> None:
        """Step with the torque that the fan has at the speed before it."""
        self.set_input("external_torque_Nm", -self.drag_Nm)
        super().step(duration_s)

    @property
    def drag_Nm(self) -> float:
        """Present torque of the fan."""
        assert isinstance(self.parameters, FanParameters)
        return self.parameters.drag_Nm(self.outputs()["v1_rad_s"])


class FanTwin(ServoAxisTwin):
    """Estimates inertia and friction from what the model's fan does not take."""

    plant: Fan

    @property
    def other_Nm(self) -> float:
        """Torque of the fan."""
        return self.plant.drag_Nm


def twin(
    model: FanParameters, config: TwinConfig, shape: Shape, cycle_s: float, boundary_inputs: BoundaryInputs
) -> FanTwin:
    """The part `twin`."""
    return FanTwin(model, config, cycle_s, Fan(model, (MotorPort(),)))


class EmulatedFan(EmulatedShaft):
    """What the load motor makes of the shaft; `torque_Nm`: of the fan."""

    def __init__(self, emulated: FanParameters, real: ServoRigParameters, cycle_s: float) -> None:
        super().__init__(emulated, real, cycle_s)
        self._fan, self.torque_Nm = emulated, 0.0

    def describe(self) -> PlantDescription:
        """As of a shaft, with the coefficient."""
        of_shaft = super().describe()
        return replace(of_shaft, parameters=(*of_shaft.parameters, Quantity(_DRAG, DRAG.unit, DRAG.title)))

    def parameter(self, name: str) -> float:
        """Present value of a parameter."""
        return self._fan.drag_Nm_s2_per_rad2 if name == _DRAG else super().parameter(name)

    def set_parameter(self, name: str, value: float) -> None:
        """Emulate another value from now on."""
        if name == _DRAG:
            self._fan = self._fan.model_copy(update={name: value})
        else:
            super().set_parameter(name, value)

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torque of the load motor, of the speed that the shaft has when it acts."""
        self.torque_Nm = self._fan.drag_Nm(speeds[0] + lead_s * self.outputs()["a1_rad_s2"])
        return [torque_Nm - self.torque_Nm for torque_Nm in super().load_torques_Nm(axes, speeds, lead_s)]


class FanLoadTask(bench.ShaftLoadTask):
    """Task of the load motor; records what is emulated."""

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Follow the measured motion."""
        super().after(sample, inputs)
        fan = self.model.machine
        assert isinstance(fan, EmulatedFan)
        sample.drag_true_Nm_s2_per_rad2, sample.tau_fan_true_Nm = fan.parameter(_DRAG), fan.torque_Nm


def tasks(config: BenchConfig, state: BenchState) -> MachineTasks:
    """The part `tasks`."""
    model = bench.shaft_load_model(config, partial(state.reports.note, "load model"), EmulatedFan)
    return bench.tasks_with(config, state, FanLoadTask(list(config.load_motors), model))


def start_values(config: ExperimentConfig) -> dict[str, float]:
    """Values of the quantities at the start, by path."""
    return servo_axis_check.start_values(config) | {DRAG.path: config.machine.drag_Nm_s2_per_rad2}


def metrics_of(shape: Shape) -> MachineMetrics:
    """The part `metrics`: those of a shaft, and the largest torque of the fan."""
    peak = Metric(
        "N·m", "largest torque of the fan", "it is not recorded", lambda segment: segment.peak(segment.get(_TORQUE))
    )
    return replace(METRICS, metrics={**METRICS.metrics, "fan_torque_peak_Nm": peak})


def panels_of(shape: Shape) -> MachinePanels:
    """The part `panels`: those of a shaft, and the torque of the fan."""
    series = (Series(_TORQUE, "fan", BLUE),)
    caption = "Torque of the emulated fan."
    fan = Panel("fan", "Torque of the fan", "torque", "N·m", series, caption=caption)
    of_axis = report.panels_of(shape)
    return replace(of_axis, panels=(*of_axis.panels, fan))


def choice(model: FanParameters, data: Measured, emulation: AnyEmulation | None) -> Choice:
    """Of the part `diagnosis`: what the fan takes by the model is no torque of the shaft."""
    of_fan = [model.drag_Nm(speed) for speed in data.v_m_s[1]]
    return diagnosed.choice(model, replace(data, tau_Nm={1: data.tau_Nm[1] - of_fan}), emulation)
