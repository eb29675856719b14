"""Which cycles a PDO set fits, on one wire and on two, as `hilbench check` tells it."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cli.in_process import hilbench

from hilbench.bench.bus_options import bus_options
from hilbench.errors import UnusableInputError
from hilbench.exchange.nodes import Nodes
from hilbench.runs.check import check_experiment
from hilbench.runs.config import load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
LINE = CONFIGS / "line_three_spans.yaml"


def test_a_line_that_does_not_fit_is_told_what_would() -> None:
    with pytest.raises(UnusableInputError, match=r"a cycle of 3 ms or more \(on two wires, .*, 2 ms\)"):
        check_experiment(load_with_overrides(LINE, changes=["cycle_time_s=0.002"]))


def test_every_frame_is_on_a_wire_and_sync_and_heartbeats_on_both() -> None:
    config = load_with_overrides(LINE).config
    nodes = Nodes(config)
    one, two = bus_options(config, nodes)
    [whole], on_both = one.bits, sum(frame.worst_case_bits for frame in nodes.cyclic_frames() if frame.name in _BOTH)
    assert sum(two.bits) == pytest.approx(whole + on_both)
    assert max(two.bits) < 0.6 * whole
    assert (one.least_lockstep_s, two.least_lockstep_s) == (0.003, 0.002)


_BOTH = ("SYNC", "heartbeats")


def test_a_cycle_that_fits_lockstep_alone_is_noted_in_real_time() -> None:
    slower = ["bus.bitrate=960000"]
    in_lockstep = check_experiment(load_with_overrides(LINE, changes=slower))
    in_real_time = check_experiment(load_with_overrides(LINE, pace="realtime", changes=slower))
    late = [note for note in in_real_time.notes if "too late in real time" in note]
    assert len(late) == 1
    assert "expected a cycle of 4 ms or more" in late[0]
    assert not [note for note in in_lockstep.notes if "real time" in note]


def test_the_command_shows_both() -> None:
    said = hilbench("check", LINE).stdout
    assert "on one wire of 1000000 bit/s: at worst" in said
    assert "fits cycles from 3 ms in lockstep" in said
    assert "on two wires (a bench can't use them yet): at worst" in said
