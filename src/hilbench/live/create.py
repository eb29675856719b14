"""Live diagnosis of a bench, for the machine of its config."""

from __future__ import annotations

from hilbench.diagnosis.emulated import emulation_of
from hilbench.live.servo_axis.machine import LiveShaft
from hilbench.live.servo_axis.warm_up import warm_up as warm_up_shaft
from hilbench.live.session import Session
from hilbench.live.web_line.machine import LiveLine
from hilbench.live.web_line.warm_up import warm_up as warm_up_line
from hilbench.plant.servo_axis.emulated_run import ShaftEmulation
from hilbench.plant.web_line.emulation import Emulation
from hilbench.topology.config import BenchConfig


def session_of(config: BenchConfig) -> Session:
    """Session of a config that asks for one, with all that it runs compiled and loaded."""
    live, cycle_s = config.twin.live_diagnosis, config.cycle_time_s
    assert live is not None, "it is started where there is one"
    emulation = emulation_of(config) if config.load_motors else None
    names = [signal.name for signal in config.signals]
    if config.machine_kind is LiveShaft.kind:
        assert emulation is None or isinstance(emulation, ShaftEmulation), "of a shaft"
        of_shaft = LiveShaft(config.servo_axis, emulation, cycle_s)
        warm_up_shaft(names, of_shaft, live, cycle_s)
        return Session(names, of_shaft, live, cycle_s)
    assert emulation is None or isinstance(emulation, Emulation), "of a web"
    of_line = LiveLine(config.web_line, emulation, cycle_s, config.shape.estimated)
    warm_up_line(names, of_line, live, cycle_s)
    return Session(names, of_line, live, cycle_s)
