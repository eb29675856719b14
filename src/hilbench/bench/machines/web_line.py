"""A section of a web line: axis 2 leads at line speed, axis 1 holds the tension, the load motor imitates the web."""

from __future__ import annotations

from math import inf

from hilbench.bench.machines.machine import MachineTasks
from hilbench.bench.state import BenchState, TwinState
from hilbench.bench.tasks.imitated_web import web_load_model
from hilbench.bench.tasks.limits import LimitWatch
from hilbench.bench.tasks.load_task import LoadTask
from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.saturation import SaturationWatch
from hilbench.bench.tasks.swing_damping import SwingDamping, SwingPlant
from hilbench.bench.tasks.task import CyclicTask, Outputs
from hilbench.bench.tasks.tension_control import TensionController
from hilbench.bench.tasks.tension_task import TensionTask
from hilbench.bench.tasks.twin_trust import TwinTrust
from hilbench.bench.tasks.watches import Watch
from hilbench.errors import BenchFaultError
from hilbench.estimation.plausibility import Problem
from hilbench.exchange.exchange import Inputs
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import LINE_SPEED
from hilbench.topology.sample import CycleSample


def tasks(config: BenchConfig, state: BenchState) -> MachineTasks:
    """The tasks of the config's web line, which has one span."""
    upstream, downstream = config.drives
    (motor,) = config.load_motors
    model, control, cycle_s = config.web_line, config.tension_control, config.cycle_time_s
    modulus_Pa, limits, reports = model.required_web.youngs_modulus_Pa, config.safety.limits, state.reports
    line_speed = Reference(LINE_SPEED, config.safety.quick_stop_m_s2 * cycle_s)
    load = WebLoadTask(motor, web_load_model(config))
    trust = TwinTrust(control, limits.tension_N.trip or inf)
    swing = SwingPlant.of_model(model, cycle_s)
    tension = TensionTask(
        upstream,
        line_speed,
        control.set_point_N,
        TensionController.of_model(control, model),
        SwingDamping(swing, control.swing_damping_ratio, modulus_Pa),
        trust,
        state.twin,
        reports,
        cycle_s,
    )
    boundary = BoundaryTask(model.upstream_strain, model.boundary.downstream_tension_N)
    return MachineTasks(
        reference=line_speed,
        quantities=(line_speed, tension, load),
        control=(boundary, tension, LineSpeedTask(downstream, line_speed), load),
        watches=(
            WebAlarms(trust, state.twin, stop_on_break=config.safety.on_web_break == "stop"),
            Watch("limits", LimitWatch(limits, modulus_Pa, cycle_s).update, reports),
            Watch("saturation", SaturationWatch(config).update, reports),
        ),
        twin_age_limit_cycles=control.twin_age_limit_cycles,
        warm_up=load.model.warm_up,
    )


class BoundaryTask(CyclicTask):
    """What the twin gets to know of the web outside the span, whether the drives are enabled or not."""

    def __init__(self, strain_prev: float, tension_next_N: float) -> None:
        self._strain_prev = strain_prev
        self._tension_next_N = tension_next_N

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Strain upstream of the span, tension downstream of it."""
        sample.strain_prev = outputs["strain_prev"] = self._strain_prev
        sample.F_next_N = outputs["F_next_N"] = self._tension_next_N

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """The same."""
        self.before(sample, outputs)


class LineSpeedTask(CyclicTask):
    """The axis downstream follows the line speed."""

    def __init__(self, drive: str, line_speed: Reference) -> None:
        self._drive = drive
        self._line_speed = line_speed

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Velocity of the axis, m/s at the web."""
        sample.v2_cmd_m_s = outputs[self._drive] = self._line_speed.present


class WebLoadTask(LoadTask):
    """The load motor pulls at the shaft of axis 2 as the imitated web would."""

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Let the web follow the measured motion; the truth of the run is recorded."""
        self.follow(sample, (sample.x1_m, sample.x2_m), (sample.v1_m_s, sample.v2_m_s), late=inputs.axes_late)
        true = self.model.machine.outputs()
        sample.F_true_N, sample.strain_true, sample.E_true_Pa = true["F1_N"], true["strain1"], true["E_Pa"]


class WebAlarms(CyclicTask):
    """The twin's alarms of the web: slip and a break open the tension loop, a break is a fault where that is wanted."""

    def __init__(self, trust: TwinTrust, twin: TwinState, *, stop_on_break: bool) -> None:
        self._trust = trust
        self._twin = twin
        self._stop_on_break = stop_on_break

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Look at the EMCY messages of this cycle. Raises BenchFaultError at a web break."""
        if self._twin.away:  # works off what it has missed, and knows nothing of now
            return
        for emergency in inputs.emergencies:
            if emergency.code in (Problem.WEB_BREAK, Problem.SLIP):
                self._trust.forget(str(emergency))
            if emergency.code == Problem.WEB_BREAK and self._stop_on_break:
                raise BenchFaultError(f"t = {sample.t_s:.3f} s: {emergency.node} reports a web break")
