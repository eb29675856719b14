"""A twin whose SYNC comes by another cycle than its config says goes by SYNC, and by nothing that comes and goes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.tiers import slow
from tests.twin.test_missed_syncs import ACCELERATION_M_S2, CYCLE_S, MODEL, TENSION_N, OnTheBus

from hilbench.canopen.bus_cycle import OTHER_CYCLE
from hilbench.exchange.emergencies import Emergency
from hilbench.runs.config import load_with_overrides
from hilbench.topology.blocks import MachineParameters
from hilbench.twin.machines.kinds import boundary, new_machine
from hilbench.twin.machines.machine import TwinMachine
from hilbench.twin.process import twin_config

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
#: What the twin's clock runs fast by, and how late a SYNC is read at most.
RATE, LATEST_S = 1.0002, 2e-4
LASTS_S = 2.5


def syncs(until_s: float, period_s: Callable[[float], float]) -> Iterator[float]:
    """Times of the SYNCs of a line, which come by this period at a time."""
    time_s = 0.0
    while time_s < until_s:
        yield time_s
        time_s += period_s(time_s)


def emergencies(twin: OnTheBus) -> list[Emergency]:
    """What the twin has said of its cycle since it was asked last."""
    frames = [frame for frame in twin.device.outbox if frame.can_id == 0x0A0]
    twin.device.outbox.clear()
    found = [Emergency.of(32, "virtual_io", frame.data) for frame in frames]
    return [each for each in found if each is not None and OTHER_CYCLE in (each.code, each.cleared)]


@pytest.mark.parametrize("period_ms", [2.1, *slow(1.0, 1.5, 1.9, 3.0, 4.0)])
def test_within_a_second_the_twin_is_in_step_with_a_sync_of_another_period(
    period_ms: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    period_s = 1e-3 * period_ms
    twin, in_step = OnTheBus(monkeypatch), OnTheBus(monkeypatch, period_s)
    in_step.machine.set_cycle_time(period_s)  # a config refuses what is no multiple of the drives' sample time
    late = np.random.default_rng(1)
    found: list[tuple[float, float]] = []
    for time_s in syncs(LASTS_S, lambda _: period_s):
        tension_N = TENSION_N + 0.03 * late.normal()  # one that does not change would be none that is measured
        twin.sync(time_s, RATE * time_s + LATEST_S * late.random(), tension_N)
        in_step.sync(time_s, time_s, tension_N)
        if time_s > 1.0:
            (x_m, now_N), (other_m, other_N) = twin.shown, in_step.shown
            found.append((x_m - other_m, now_N - other_N))
    ahead_m, off_N = np.array(found).T
    # Where its axes were when it came to be in step they are not asked: they are not transferred here.
    late_s = np.abs(ahead_m - ahead_m[0]) / (ACCELERATION_M_S2 * LASTS_S)
    assert np.max(late_s) < 1e-4
    assert np.max(np.abs(off_N)) < 0.1
    (told,) = emergencies(twin)
    assert told.size == pytest.approx(period_s, rel=1e-6)
    assert f"{period_ms:g} ms" in str(told)
    assert twin.said == [f"SYNC comes every {period_ms:g} ms, cycle_time_s is 2 ms: the twin goes by SYNC"]


@pytest.mark.parametrize("period_s", [0.01, *slow(0.0021)])
def test_a_bench_whose_sync_comes_before_its_drives_are_enabled_is_started_with_a_twin_that_goes_by_it(
    period_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    twin, in_step = OnTheBus(monkeypatch), OnTheBus(monkeypatch, period_s)
    in_step.machine.set_cycle_time(period_s)
    noise = np.random.default_rng(4)
    for time_s in syncs(0.6, lambda _: period_s):
        twin.sync(0.0, time_s - 0.6, enabled=False)
    in_step.sync(0.0, -period_s, enabled=False)
    off_N = []
    for time_s in syncs(2.0, lambda _: period_s):
        tension_N = TENSION_N + 0.1 * noise.normal()
        for each in (twin, in_step):
            each.sync(time_s, time_s, tension_N)
        off_N.append(twin.shown[1] - in_step.shown[1])
    assert np.max(np.abs(off_N)) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("period_s", [0.0021, 0.004, 0.001])
def test_a_period_that_changes_under_way_leaves_what_is_known_as_it_is(
    period_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    modulus_Pa = MODEL.youngs_modulus_Pa(1)
    twin, noise = OnTheBus(monkeypatch), np.random.default_rng(2)
    twin.rests_until_now()
    # The web pulls with a tenth more than the model's would: that has been found when the period changes.
    off, in_step = [], []
    for time_s in syncs(4.5, lambda time_s: period_s if 1.5 <= time_s < 3.0 else CYCLE_S):
        twin.sync(time_s, time_s + LATEST_S * noise.random(), 1.1 * TENSION_N + 0.1 * noise.normal())
        _, now_Pa, *_ = twin.machine.published()
        since_s = time_s % 1.5 if time_s >= 1.5 else 0.0
        if since_s > 0.5:
            off.append(now_Pa / (1.1 * modulus_Pa) - 1.0)
            in_step.append(twin.machine.in_use.synchronized)
    assert np.max(np.abs(off)) < 0.005
    assert all(in_step)
    other, back = emergencies(twin)
    assert (other.code, back.cleared) == (OTHER_CYCLE, OTHER_CYCLE)
    assert twin.said[-1] == "SYNC comes every 2 ms again, as cycle_time_s says"


def test_until_it_goes_by_sync_the_twin_does_not_call_itself_synchronized(monkeypatch: pytest.MonkeyPatch) -> None:
    twin, told = OnTheBus(monkeypatch), list[bool]()
    twin.rests_until_now()
    for time_s in syncs(2.0, lambda time_s: CYCLE_S if time_s < 1.0 else 0.0015):
        twin.sync(time_s, time_s, TENSION_N + (0.1 if len(told) % 2 else -0.1))
        told.append(twin.is_said_to_be_synchronized)
        if time_s >= 1.0 and twin.said:
            break
    before, meanwhile = told[:500], told[510:-1]
    assert all(before[250:])
    assert len(meanwhile) > 100
    assert not any(meanwhile)


@pytest.mark.slow
def test_a_period_that_flutters_is_followed_ever_more_seldom(monkeypatch: pytest.MonkeyPatch) -> None:
    twin, noise = OnTheBus(monkeypatch), np.random.default_rng(3)
    off_N = []
    for time_s in syncs(20.0, lambda time_s: CYCLE_S if time_s % 1.0 < 0.5 else 0.0025):
        twin.sync(time_s, time_s, TENSION_N + 0.1 * noise.normal())
        off_N.append(twin.shown[1] - TENSION_N)
    assert len(twin.said) <= 2
    assert np.max(np.abs(off_N[2000:])) < 5.0


def measured_by(machine: TwinMachine, model: MachineParameters, time_s: float) -> list[tuple[float, float]]:
    """Positions and torques of axes that turn alike, by what a machine expects of them."""
    return [
        (time_s * model.motor_rad_per_unit(axis), 0.1 + 0.01 * (round(1e4 * time_s) % 7))
        for axis in range(1, len(machine.ports) + 1)
    ]


@pytest.mark.parametrize("config", ["servo_axis", "line_three_spans", *slow("line_with_dancer", "winding_line")])
def test_a_machine_of_any_kind_goes_on_with_cycles_of_another_length(config: str) -> None:
    bench = load_with_overrides(CONFIGS / f"{config}.yaml").config
    model, nominal_s = bench.machine, bench.cycle_time_s
    around = boundary(model, bench.shape)
    machine = new_machine(model, twin_config(bench), bench.shape, nominal_s, around.__getitem__)
    time_s = 0.0
    for cycle_s in (nominal_s, 1.05 * nominal_s, 2.0 * nominal_s, nominal_s):
        machine.set_cycle_time(cycle_s)
        for _ in range(50):
            before = measured_by(machine, model, time_s)
            time_s += cycle_s
            now = measured_by(machine, model, time_s)
            if time_s == cycle_s:
                machine.release(before, now)
            machine.compare(time_s, now)
            machine.listen()
            began_s = machine.plant.time_s
            machine.plant.step(cycle_s)
            assert machine.plant.time_s - began_s == pytest.approx(cycle_s)
        machine.keep()
    assert np.all(np.isfinite(machine.published()) | np.isinf(machine.published()))
