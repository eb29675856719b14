"""A line is brought to rest in the ratio of its rollers' speeds, whatever stops it: the web is not torn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle import in_process
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.tasks.emulated_web import emulated_web
from hilbench.bench.tasks.limits import LimitTripError
from hilbench.can.frame import Frame
from hilbench.canopen.emergency_stop import EMERGENCY_STOP_COB_ID
from hilbench.errors import BenchFaultError, EmergencyStopError
from hilbench.exchange.addressing import drive_settings
from hilbench.hardware import simulation
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.runs.check import check_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides
from hilbench.topology.parts import Role

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
LINE_SPEED_M_S = 2.0
#: How far a tension may leave what it was while the bench brings the line to rest.
MOST_OFF_N = 15.0
#: What the web bears where the drives stop by themselves, and the load motors let go: neither slack nor twice as tight.
LEAST_N, MOST_N = 20.0, 170.0


class Stand:
    """The true motion of the shafts of a bench in this process, and its bus."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.motion: list[tuple[float, list[float]]] = []  # duration, angles of the axes' motors
        self.bus: in_process.InProcess | None = None
        self.began = 0  # steps of the motion before what happens
        make, boot = simulation.new_rig, in_process.InProcess.boot

        def new_rig(*given: Any) -> Any:
            rig = make(*given)
            self.motion.clear()  # the last one that is made is the stand
            step, steps_in_modes = rig.step, rig.steps_in_modes

            def record(duration_s: float) -> None:
                outputs: Mapping[str, float] = rig.outputs()
                axes = rig.describe().axes
                self.motion.append((duration_s, [outputs[f"x{axis}_rad"] for axis in range(1, axes + 1)]))

            def recorded(duration_s: float) -> None:
                step(duration_s)
                record(duration_s)

            def recorded_in_modes(set_points: Any, duration_s: float, shown: Any) -> Any:
                step = steps_in_modes(set_points, duration_s, shown)

                def stepped() -> None:
                    step()
                    record(duration_s)

                return stepped

            monkeypatch.setattr(rig, "step", recorded)
            monkeypatch.setattr(rig, "steps_in_modes", recorded_in_modes)
            return rig

        def booted(participants: in_process.InProcess) -> None:
            self.bus = participants
            boot(participants)

        monkeypatch.setattr(simulation, "new_rig", new_rig)
        monkeypatch.setattr(in_process.InProcess, "boot", booted)

    def send(self, can_id: int, data: bytes) -> None:
        """From somebody else on the bus."""
        assert self.bus is not None
        self.bus.bus.open_link().send([Frame(can_id, data)])

    def web(self, given: LoadedConfig) -> tuple[np.ndarray, np.ndarray]:
        """Tensions (n, K) and speeds at the web (n, N) that the true motion makes, at each of its steps."""
        model = given.config.web_line
        follower = LineFollower(emulated_web(model, given.config.load))
        per_m = np.array([model.motor_rad_per_m(axis) for axis in range(1, model.axis_count + 1)])
        tensions, speeds = [], []
        for duration_s, angles in self.motion:
            follower.follow(np.array(angles) / per_m, duration_s)
            tensions.append(follower.tension_N)
            speeds.append(follower.v_m_s)
        return np.array(tensions), np.array(speeds)

    def line_with_stations(self, given: LoadedConfig) -> tuple[np.ndarray, np.ndarray]:
        """The same of a line with stations, with the ways of its axes at the web (n, N), m."""
        model = given.config.web_line
        follower = LineFollower(emulated_web(model, given.config.load))
        per_m = np.array([model.motor_rad_per_m(axis) for axis in range(1, model.axis_count + 1)])
        tensions, ways = [], []
        for duration_s, angles in self.motion:
            ways.append(np.array(angles) / per_m)
            follower.follow(ways[-1], duration_s)
            tensions.append(follower.tension_N)
        return np.array(tensions), np.array(ways)


@pytest.fixture
def stand(monkeypatch: pytest.MonkeyPatch) -> Stand:
    return Stand(monkeypatch)


def line(folder: Path, *changes: str) -> LoadedConfig:
    bus = f"embedded:{folder.name}"
    return load_with_overrides(CONFIGS / "line_three_spans.yaml", bus=bus, changes=changes)


def run_until(given: LoadedConfig, of: type[BaseException], happens: Callable[[], None] = lambda: None) -> Bench:
    """Go to full speed, let something happen, and go on until the bench ends for it."""
    bench = Bench(given.config, participants=Participants.IN_PROCESS)

    def experiment() -> None:
        with bench:
            bench.ramp("line_speed_m_s", LINE_SPEED_M_S, duration_s=1.5)
            bench.run(0.5)
            happens()
            bench.run(1.0)

    with pytest.raises(of):
        experiment()
    return bench


def on_the_way_to_rest(stand: Stand, given: LoadedConfig) -> tuple[np.ndarray, np.ndarray]:
    """Tensions (n, K) and speeds (n, N) since the line last had full speed."""
    tensions, speeds = stand.web(given)
    slowest = speeds.min(axis=1)
    since = int(np.flatnonzero(slowest > 0.97 * slowest.max())[-1])
    assert slowest[since] > 1.8
    assert np.abs(speeds[-1]).max() < 0.03
    return tensions[since:], speeds[since:]


def test_a_limit_that_trips_stops_all_rollers_in_ratio(tmp_path: Path, stand: Stand) -> None:
    given = line(tmp_path, "safety.limits.speed_m_s={warning: 1.8, trip: 1.95}")
    bench = run_until(given, LimitTripError)
    assert bench.safe_state_problems == []
    tensions, speeds = on_the_way_to_rest(stand, given)
    assert np.abs(tensions - tensions[0]).max() < MOST_OFF_N
    moving = speeds.min(axis=1) > 0.5
    assert np.ptp(speeds[moving], axis=1).max() < 0.03


@pytest.mark.slow
def test_a_load_motor_that_is_lost_stops_all_rollers_in_ratio(tmp_path: Path, stand: Stand) -> None:
    given = line(tmp_path)
    run_until(given, BenchFaultError, lambda: stand.send(0x000, bytes((0x81, 6))))  # NMT: reset node 6
    tensions, _ = on_the_way_to_rest(stand, given)
    assert np.abs(tensions - tensions[0]).max() < MOST_OFF_N


@pytest.mark.slow
def test_an_axis_that_coasts_is_told_with_the_spans_that_it_held(tmp_path: Path, stand: Stand) -> None:
    given = line(tmp_path)
    bench = Bench(given.config, participants=Participants.IN_PROCESS)

    def switched_off() -> None:
        with bench:
            bench.ramp("line_speed_m_s", LINE_SPEED_M_S, duration_s=1.5)
            stand.send(0x000, bytes((0x81, 2)))  # NMT: reset node 2, which lets its motor go
            bench.run(1.0)

    with pytest.raises(BenchFaultError, match="node 2") as fault:
        switched_off()
    second = list(given.config.drives)[1].replace("_", " ")
    assert f"; {second} does not answer, and coasts" in str(fault.value)
    assert str(fault.value).endswith("nothing holds the tensions of spans 1 and 2")
    assert str(fault.value).count("coasts") == 1


@pytest.mark.slow
def test_an_operator_who_interrupts_stops_all_rollers_in_ratio(tmp_path: Path, stand: Stand) -> None:
    given = line(tmp_path)

    def interrupted() -> None:
        raise KeyboardInterrupt

    run_until(given, KeyboardInterrupt, interrupted)
    tensions, _ = on_the_way_to_rest(stand, given)
    assert np.abs(tensions - tensions[0]).max() < MOST_OFF_N


@pytest.mark.slow
def test_after_an_emergency_stop_the_drives_ramps_keep_the_web_whole(tmp_path: Path, stand: Stand) -> None:
    given = line(tmp_path)
    run_until(given, EmergencyStopError, lambda: stand.send(EMERGENCY_STOP_COB_ID, b""))
    tensions, _ = on_the_way_to_rest(stand, given)
    assert tensions.min() > LEAST_N
    assert tensions.max() < MOST_N


def test_the_slowest_axis_sets_the_ramp_of_all(tmp_path: Path) -> None:
    """Its drive has no torque for the ramp that is asked for."""
    heavy = "machine.rollers.inertia_kg_m2=[1.167, 1.167, 5.0, 1.167]"
    mass_kg = (5.0 + 25.0 * 0.001) / 0.2**2
    config = line(tmp_path, heavy).config
    assert config.quick_stop_per_s2 == pytest.approx(0.8 * 9.0 * 5.0 / 0.2 / mass_kg)
    assert config.quick_stop_per_s2 < line(tmp_path).config.quick_stop_per_s2 == 3.0
    written = {part.name: drive_settings(config, part).parameters[0x6085, 0] for part in config.parts_of(Role.AXIS)}
    assert len(set(written.values())) == 1
    assert any("axis 3" in note and "quick stop" in note for note in check_experiment(line(tmp_path, heavy)).notes)


def test_one_span_is_stopped_by_its_drives(tmp_path: Path) -> None:
    demonstrator = load_with_overrides(CONFIGS / "web_section_step.yaml").config
    assert not demonstrator.stops_together
    assert demonstrator.quick_stop_per_s2 == demonstrator.safety.quick_stop_m_s2


@pytest.mark.slow
def test_reels_and_an_accumulator_are_brought_to_rest_together_in_the_middle_of_a_reel_change(
    tmp_path: Path, stand: Stand
) -> None:
    given = load_with_overrides(CONFIGS / "winding_line.yaml", bus=f"embedded:{tmp_path.name}")
    bench = Bench(given.config, participants=Participants.IN_PROCESS)

    def reel_change() -> None:
        with bench:
            bench.ramp("line_speed_m_s", 1.2, duration_s=2.0)
            bench.run(1.0)
            bench.set("position_control.store.feed", 0.0)
            bench.run(2.0)  # the unwinder runs at less than half its speed now
            stand.began = len(stand.motion)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reel_change()
    tensions, ways = stand.line_with_stations(given)
    since = stand.began
    speeds_m_s = np.diff(ways[since:], axis=0) / stand.motion[-1][0]
    at_rest = int(np.flatnonzero(np.abs(speeds_m_s).max(axis=1) < 0.01)[0])
    stopping_N = tensions[since : since + at_rest]
    assert np.abs(stopping_N - stopping_N[0]).max() < MOST_OFF_N
    assert speeds_m_s[0, 0] < 0.5 * speeds_m_s[0, 1]
    ratios = speeds_m_s[: at_rest // 2] / speeds_m_s[: at_rest // 2, 1:2]
    assert np.ptp(ratios, axis=0).max() < 0.05


@pytest.mark.slow
def test_reels_in_torque_mode_keep_the_tension_while_the_line_is_brought_to_rest(tmp_path: Path, stand: Stand) -> None:
    given = load_with_overrides(CONFIGS / "koc_2002_torque.yaml", bus=f"embedded:{tmp_path.name}")
    bench = Bench(given.config, participants=Participants.IN_PROCESS)

    def interrupted() -> None:
        with bench:
            bench.ramp("line_speed_m_s", 2.0, duration_s=2.0)
            bench.run(1.0)
            stand.began = len(stand.motion)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    tensions, ways = stand.line_with_stations(given)
    speeds_m_s = np.diff(ways[stand.began :], axis=0) / stand.motion[-1][0]
    at_rest = int(np.flatnonzero(np.abs(speeds_m_s).max(axis=1) < 0.03)[0])
    stopping_N = tensions[stand.began : stand.began + at_rest]
    assert np.abs(stopping_N - 15.0).max() < 1.5
