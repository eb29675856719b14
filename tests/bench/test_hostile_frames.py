"""Whatever frame comes to the bench: it is ignored and counted, taken, or a bench fault that names the node."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.bench.bench_nodes import nodes, shipped
from tests.bench.samples import sample_of_two_axes

from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.errors import BenchFaultError
from hilbench.exchange.nodes import Nodes

#: Every function code of CiA 301 with the bench's nodes and others, and what is no CANopen at all.
IDENTIFIERS = st.one_of(
    st.sampled_from([0x000, 0x001, 0x080, 0x100, 0x7E5]),
    st.builds(
        lambda code, node: code + node,
        st.sampled_from([0x080, 0x180, 0x200, 0x280, 0x380, 0x580, 0x600, 0x700]),
        st.sampled_from([1, 2, 3, 17, 18, 32, 99, 127]),
    ),
    st.builds(
        lambda identifier, flag: identifier | flag, st.integers(0, 0x7FF), st.sampled_from([REMOTE_FLAG, EXTENDED_FLAG])
    ),
)
FRAMES = st.builds(Frame, IDENTIFIERS, st.binary(max_size=8) | st.binary(min_size=8, max_size=8))


NAMES = ("axis1 (node 1)", "axis2 (node 2)", "load (node 3)")


def told(bench: Nodes, frames: list[Frame]) -> str:
    """Which node a bench fault names, "" for none."""
    try:
        bench.decode(frames)
    except BenchFaultError as error:
        return next((name for name in NAMES if str(error).startswith(name)), str(error))
    return ""


@settings(max_examples=8, deadline=None, database=None)
@given(st.lists(st.lists(FRAMES, max_size=12), min_size=1, max_size=150))
def test_any_frames(cycles: list[list[Frame]]) -> None:
    bench, sample = nodes(), sample_of_two_axes()
    for frames in cycles:
        assert told(bench, frames) in ("", *NAMES), frames
        bench.fill(sample)
        bench.encode({"strain_prev": 0.0, "F_next_N": 0.0})


def test_a_pdo_of_another_length_is_counted_and_not_taken() -> None:
    bench = nodes()
    bench.decode([Frame(0x181, bytes(8)), Frame(0x1A0, bytes(8))])
    bench.decode([Frame(0x181, bytes(7)), Frame(0x281, b""), Frame(0x1A0, bytes(4)), Frame(0x081, b"\x10")])
    assert bench.malformed == 4
    assert not bench.emergencies
    assert not bench.axes[0].feedback.fresh


@pytest.mark.parametrize(("data", "text"), [(b"\x00", r"axis2 \(node 2\) has restarted"), (b"\x7f", "7Fh")])
def test_a_drive_that_leaves_operational_is_named(data: bytes, text: str) -> None:
    with pytest.raises(BenchFaultError, match=text):
        nodes().decode([Frame(0x702, data)])


def test_a_drive_whose_heartbeat_stays_away_is_named_and_the_twin_is_no_fault() -> None:
    bench = nodes()
    bench.decode([Frame(0x701, b"\x05"), Frame(0x720, b"\x05")])
    period = round(shipped().master.node_heartbeat_ms * 1e-3 / shipped().cycle_time_s)
    for _ in range(3 * period):
        bench.decode([])
    assert bench.twin_problem == ""
    said = {told(bench, [Frame(0x720, b"\x7f")]) for _ in range(2 * period)}
    assert said == {"", "axis1 (node 1)"}
    assert "virtual io (node 32) has left OPERATIONAL" in bench.twin_problem
