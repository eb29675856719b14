"""Servo axis: its drive follows a speed, the load motor emulates inertia and friction that the stand lacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import nan

from hilbench.bench.machines.machine import MachineTasks
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.load_model import LoadModel, LoadTask
from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.saturation import SaturationWatch
from hilbench.bench.tasks.shaft_limits import limit_watch
from hilbench.bench.tasks.task import CompiledStages, StagedTask
from hilbench.bench.tasks.watches import QuietWatch
from hilbench.exchange.exchange import Inputs
from hilbench.plant.fmu.follower import FmuFollower
from hilbench.plant.interface import Follower
from hilbench.plant.sampled_shaft import emulation_delay_s
from hilbench.plant.servo_axis.emulation import EmulatedShaft
from hilbench.plant.servo_axis.stability import sampled_shaft
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import SPEED
from hilbench.topology.sample import CycleSample, PerSample

#: Signal of the axis's speed command.
_COMMAND = "v1_cmd_rad_s"
#: Age of the twin's data at which it counts as lost; no controller depends on them.
_TWIN_AGE_LIMIT_CYCLES = 10
#: Travel per cycle above which cycles can be counted by it: some counts of a 16-bit encoder.
_LEAST_TRAVEL_RAD = 1e-4


def shaft_load_model(
    config: BenchConfig, report: Callable[[str], None] = print, emulated: type[EmulatedShaft] = EmulatedShaft
) -> LoadModel:
    """The load model of a config's servo axis; it does not know hidden effects of the stand.

    `report` gets the log messages of an FMU in it; `emulated`: follower of the machine.
    """
    real, cycle_s = config.servo_rig_parameters(effects=()), config.cycle_time_s
    machine: Follower = emulated(config.emulated_shaft(), real, cycle_s)
    if config.load.fmu is not None:
        truths = [quantity.name for quantity in machine.describe().outputs]
        machine = FmuFollower(config.load.fmu, config.machine.machine_kind, "rad", 1, cycle_s, truths, report)
    return LoadModel(
        machine, [1], cycle_s, emulation_delay_s(sampled_shaft(real, cycle_s)), _LEAST_TRAVEL_RAD, config.load.effects
    )


def tasks(config: BenchConfig, state: BenchState) -> MachineTasks:
    """The tasks of the config's servo axis."""
    model = shaft_load_model(config, partial(state.reports.note, "load model"))
    return tasks_with(config, state, ShaftLoadTask(list(config.load_motors), model))


def tasks_with(config: BenchConfig, state: BenchState, load: LoadTask) -> MachineTasks:
    """The tasks of an axis that follows its speed, with this task of the load motor."""
    (drive,) = config.drives
    (motor,) = config.load_motors
    speed = Reference(SPEED, config.quick_stop_per_s2 * config.cycle_time_s)
    return MachineTasks(
        reference=speed,
        quantities=(speed, load.model),
        control=(SpeedTask(drive, speed), load),
        watches=(
            QuietWatch("limits", limit_watch(config, motor), state.reports),
            QuietWatch("saturation", SaturationWatch(config), state.reports),
        ),
        twin_age_limit_cycles=_TWIN_AGE_LIMIT_CYCLES,
        warm_up=load.model.warm_up,
    )


class SpeedTask(StagedTask):
    """The axis follows its reference."""

    def __init__(self, drive: str, speed: Reference) -> None:
        self._drive, self._speed = drive, speed
        speed.warm_up_shown()

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage that makes the speed command, rad/s at the motor."""
        return CompiledStages(before=[self._speed.shown_in(sample, _COMMAND)], shown={self._drive: _COMMAND})


class ShaftLoadTask(LoadTask):
    """The load motor applies to the shaft the torque of the emulated mechanics."""

    def __init__(self, motors: Sequence[str], model: LoadModel) -> None:
        super().__init__(motors, model)
        known = {quantity.name for quantity in model.machine.describe().parameters}
        self._has_inertia, self._has_friction = "inertia_kg_m2" in known, "coulomb_friction_Nm" in known
        names = ["x1_rad", "v1_rad_s", *(command for _, command in self._commands)]
        self._at = PerSample(lambda sample: type(sample).places(names))

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Let the emulated shaft follow the measured motion; record its true parameters."""
        late = inputs.axes_late
        if self.model.follow_in(sample.reals, self._at(sample), late=late) is None:
            self.follow(sample, (sample.x1_rad,), (sample.v1_rad_s,), late=late)
        machine = self.model.machine
        sample.J_true_kg_m2 = machine.parameter("inertia_kg_m2") if self._has_inertia else nan
        sample.coulomb_true_Nm = machine.parameter("coulomb_friction_Nm") if self._has_friction else nan

    def compiled_stages(self, sample: CycleSample) -> CompiledStages | None:
        """Compiled stage that follows the measured motion; the true parameters stay as they are. None of a subclass."""
        return self._follows(sample, self._at(sample), lambda _: True) if type(self) is ShaftLoadTask else None
