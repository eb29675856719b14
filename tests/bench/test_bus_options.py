"""Which cycles a PDO set fits, on one wire and on two, as `hilbench check` tells it."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cli.in_process import hilbench

from hilbench.bench.bus_options import bus_options
from hilbench.bench.schedule import schedule
from hilbench.can.load import CyclicFrame
from hilbench.can.wire import worst_case_fd_bits
from hilbench.errors import UnusableInputError
from hilbench.exchange.nodes import Nodes
from hilbench.runs.check import check_experiment
from hilbench.runs.config import load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
LINE = CONFIGS / "line_three_spans.yaml"


def test_a_line_that_does_not_fit_is_told_what_would() -> None:
    with pytest.raises(UnusableInputError, match=r"a cycle of 3 ms or more \(on two wires 2 ms, .*yet\)"):
        check_experiment(load_with_overrides(LINE, changes=["cycle_time_s=0.002"]))


def test_every_frame_is_on_a_wire_and_sync_and_heartbeats_on_both() -> None:
    config = load_with_overrides(LINE).config
    nodes = Nodes(config)
    options = bus_options(config, nodes)
    one, two = options.one_wire, options.two_wires
    [whole], on_both = one.bits, sum(frame.worst_case_bits for frame in nodes.cyclic_frames() if frame.name in _BOTH)
    assert sum(two.bits) == pytest.approx(whole + on_both)
    assert max(two.bits) < 0.6 * whole
    assert (one.least_lockstep_s, two.least_lockstep_s) == (0.003, 0.002)


_BOTH = ("SYNC", "heartbeats")


def test_the_twin_on_a_wire_of_its_own_takes_from_the_other_what_it_says_and_is_told() -> None:
    config = load_with_overrides(CONFIGS / "web_section_step.yaml").config
    nodes = Nodes(config)
    frames, apart = nodes.cyclic_frames(), bus_options(config, nodes).twin_apart
    virtual = {node.node_id for node in (config.twin.node, *(drive.virtual for drive in config.drives.values()))}
    own = sum(frame.worst_case_bits for frame in frames if frame.can_id % 128 in virtual)
    of_all = sum(frame.worst_case_bits for frame in frames)
    on_both = sum(frame.worst_case_bits for frame in frames if frame.name in _BOTH)
    assert apart.bits == pytest.approx((of_all - own, own + on_both))
    assert own > 300.0


def test_can_fd_sends_the_same_frames_with_fast_data() -> None:
    config = load_with_overrides(LINE).config
    nodes = Nodes(config)
    options = bus_options(config, nodes)
    bits = 0.0
    for frame in nodes.cyclic_frames():
        slow, fast = worst_case_fd_bits(frame.data_bytes)
        bits += frame.per_cycle * (slow + 0.2 * fast)
    assert options.can_fd.bits == (pytest.approx(bits),)
    assert options.can_fd.least_lockstep_s < options.one_wire.least_lockstep_s


def test_a_cycle_that_fits_lockstep_alone_is_noted_in_real_time() -> None:
    slower = ["bus.bitrate=960000"]
    in_lockstep = check_experiment(load_with_overrides(LINE, changes=slower))
    in_real_time = check_experiment(load_with_overrides(LINE, pace="realtime", changes=slower))
    late = [note for note in in_real_time.notes if "too late in real time" in note]
    assert len(late) == 1
    assert "expected a cycle of 4 ms or more" in late[0]
    assert not [note for note in in_lockstep.notes if "real time" in note]


@pytest.mark.parametrize(
    ("name", "cycle_ms"), [("line_three_spans", 4), ("winding_line", 4), ("line_with_dancer", 3), ("servo_axis", 2)]
)
def test_in_real_time_it_is_the_least_cycle_in_which_every_frame_is_in_time(name: str, cycle_ms: int) -> None:
    config = load_with_overrides(CONFIGS / f"{name}.yaml").config
    nodes = Nodes(config)
    frames, least_s = nodes.cyclic_frames(), bus_options(config, nodes).one_wire.least_realtime_s
    assert least_s == pytest.approx(1e-3 * cycle_ms)
    assert all(slot.fits for slot in schedule(frames, least_s, config.bus.bitrate))
    assert not all(slot.fits for slot in schedule(frames, least_s - 1e-3, config.bus.bitrate))


def test_the_command_shows_all() -> None:
    said = hilbench("check", LINE).stdout
    assert "on one wire of 1000000 bit/s: at worst" in said
    assert "fits cycles from 3 ms in lockstep" in said
    assert "on two wires (a bench can't use that yet): at worst" in said
    assert "on two wires, one of them the twin's (a bench can't use that yet): at worst" in said
    assert "on one wire with CAN FD at 5000000 bit/s (a bench can't use that yet): at worst" in said


def test_the_check_says_when_each_frame_of_a_cycle_is_over_at_worst() -> None:
    frames = [CyclicFrame("SYNC", 0x080, 0), CyclicFrame("low", 0x382, 8, 0.2), CyclicFrame("high", 0x181, 8)]
    frames += [CyclicFrame("told", 0x201, 4), CyclicFrame("heartbeats", 0x701, 1, 0.1)]
    slots = {slot.name: slot for slot in schedule(frames, 0.001, 1_000_000)}
    assert list(slots) == ["SYNC", "high", "low", "told"]
    # Every possible stuff bit: 0, 1, 4 and 8 bytes are 55, 65, 95 and 135 bit times. A heartbeat may have begun.
    assert slots["SYNC"].ends_s == pytest.approx((65 + 55) * 1e-6)
    assert slots["high"].ends_s == pytest.approx((135 + 55 + 135) * 1e-6)  # the other one may have begun
    assert slots["low"].ends_s == pytest.approx((65 + 55 + 135 + 135) * 1e-6)
    assert slots["told"].ends_s == pytest.approx((65 + 95) * 1e-6)
    assert [slot.is_set_point for slot in slots.values()] == [False, False, False, True]


def test_the_command_names_the_frames_that_come_too_late_in_real_time() -> None:
    fits, late = hilbench("check", CONFIGS / "web_section_step.yaml").stdout, hilbench("check", LINE).stdout
    assert "a cycle at worst: answers are over after 1.0" in fits
    assert "too late" not in fits
    assert "in real time too late: virtual io TPDO6 (492h" in late
