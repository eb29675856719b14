"""A twin in real time whose bench leaves SYNCs out: what the axes did meanwhile is no jolt of the web."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilbench.can.frame import Frame
from hilbench.canopen.clock import MonotonicClock
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.estimation.plausibility import Problem
from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.plant.effects import MachineKind
from hilbench.plant.motor_port import MotorMode
from hilbench.runs.config import load_with_overrides
from hilbench.topology.process_data.of_kind import process_data
from hilbench.twin.axis_listener import AxisListener
from hilbench.twin.machines.kinds import new_machine
from hilbench.twin.machines.web_line import boundary
from hilbench.twin.model_change import ChangeableMachine
from hilbench.twin.process import TwinApplication
from hilbench.twin.setup import twin_setup
from hilbench.twin.virtual_io import VirtualIo

CONFIG = load_with_overrides(Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml").config
MODEL = CONFIG.web_line
CYCLE_S = CONFIG.cycle_time_s
ACCELERATION_M_S2 = 1.0
PULL_N = 10.0  #: what the motor of axis 2 pulls with beside the tension behind it


class Clock(MonotonicClock):
    """A clock that stands until it is moved."""

    def __init__(self) -> None:
        super().__init__()
        self.time_ns = 0

    def now_ns(self) -> int:
        return self.time_ns


def motion(time_s: float) -> list[tuple[float, float]]:
    """Both axes' position (rad) and torque (N·m) of a line that starts from rest, with 80 N in its web."""
    way_m = 0.5 * ACCELERATION_M_S2 * time_s**2
    force_N = MeasuredBalance(MODEL).mass_kg * ACCELERATION_M_S2
    pulls_N = (force_N - PULL_N, force_N + PULL_N)
    return [(way_m * MODEL.motor_rad_per_m(k), pulls_N[k - 1] / MODEL.motor_rad_per_m(k)) for k in (1, 2)]


def test_after_missed_cycles_positions_of_two_instants_are_told_from_those_of_one() -> None:
    setup = twin_setup(CONFIG)
    around = boundary(MODEL)
    machine = new_machine(MODEL, setup.twin, setup.shape, CYCLE_S, lambda name: around[name])
    for port in machine.ports:
        port.mode, port.torque_limit_Nm = MotorMode.VELOCITY, 9.0
    cycle = 1000  # at 2 m/s
    machine.release(motion((cycle - 1) * CYCLE_S), motion(cycle * CYCLE_S))
    for _ in range(10):
        cycle += 1
        assert machine.compare(cycle * CYCLE_S, motion(cycle * CYCLE_S))
    for _ in range(4):
        cycle += 1
        machine.miss()
    cycle += 1
    late, now = motion((cycle - 1) * CYCLE_S)[0], motion(cycle * CYCLE_S)[1]
    assert not machine.compare(cycle * CYCLE_S, [late, now])
    used = []
    for _ in range(5):
        cycle += 1
        used.append(machine.compare(cycle * CYCLE_S, motion(cycle * CYCLE_S)))
    assert used[-1], "the twin goes on with what is measured"


@pytest.mark.parametrize("seed", range(4))
def test_a_start_at_which_the_bench_leaves_syncs_out_is_no_web_break(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    setup = replace(twin_setup(CONFIG), clock=clock)
    node = setup.virtual_io
    device = Device(load_eds(node.eds, node.node_id), node.node_id, clock)
    virtual_io = VirtualIo(device, process_data(MachineKind(MODEL.kind), setup.shape), boundary(MODEL))
    machine = ChangeableMachine(
        lambda _: new_machine(MODEL, setup.twin, setup.shape, CYCLE_S, virtual_io.told), CYCLE_S
    )
    application = TwinApplication(setup, machine, [], device, virtual_io)
    listeners = [AxisListener(axis, CYCLE_S) for axis in setup.real_axes]
    now = motion(0.0)
    measured = {listener.cob_id: now[axis] for axis, listener in enumerate(listeners)}
    monkeypatch.setattr(AxisListener, "decode", lambda self, data: measured[self.cob_id])
    missed = np.random.default_rng(seed).random(400) < 0.1
    problems: set[Problem | None] = set()
    deviations = []
    for cycle in range(400):
        clock.time_ns = round(cycle * CYCLE_S * 1e9)
        if cycle > 2 and missed[cycle]:
            continue
        for port in machine.ports:
            port.mode, port.torque_limit_Nm = MotorMode.VELOCITY, 9.0
            port.setpoint = ACCELERATION_M_S2 * cycle * CYCLE_S * MODEL.motor_rad_per_m(1)
        application.before_sync(0)
        application.after_sync()
        for listener, values in zip(listeners, motion(cycle * CYCLE_S), strict=True):
            measured[listener.cob_id] = values
            application.on_frame(Frame(listener.cob_id, bytes(listener.size)))
        problems.add(machine.problem)
        _, modulus_Pa, deviation_Pa, *_ = machine.published()
        deviations.append(deviation_Pa / modulus_Pa)
    assert problems == {None}
    assert max(deviations[1:]) < 0.3  # beyond that the tension loop is opened
