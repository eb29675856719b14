"""Worst-case bus load."""

from __future__ import annotations

import pytest

from hilbench.can.frame import EXTENDED_FLAG
from hilbench.can.load import CyclicFrame, cycle_load

AXES = [
    frame
    for node in (1, 2, 3)
    for frame in (
        CyclicFrame(f"TPDO1 of node {node}", 0x180 + node, 8),
        CyclicFrame(f"RPDO1 of node {node}", 0x200 + node, 6 if node < 3 else 4),
    )
]
DESIGN = [
    *AXES,
    CyclicFrame("TPDO2 of node 1", 0x281, 4),
    CyclicFrame("TPDO2 of node 2", 0x282, 4),
    CyclicFrame("virtual I/O: TPDO1", 0x1A0, 8),
    CyclicFrame("virtual I/O: TPDO2", 0x2A0, 8, per_cycle=0.1),
    CyclicFrame("virtual I/O: RPDO1", 0x220, 8),
    CyclicFrame("SYNC", 0x80, 0),
]


def test_the_designs_cycle() -> None:
    """Design, section 4: about 1260 of the 2000 bit times of a 2 ms cycle, 63 %."""
    load = cycle_load(DESIGN, 0.002, 1_000_000)
    assert load.capacity_bits == pytest.approx(2000)
    assert load.bits == pytest.approx(1260, abs=10)
    assert load.fraction == pytest.approx(0.63, abs=0.005)


def test_extended_frames_are_longer() -> None:
    assert cycle_load([CyclicFrame("x", 0x123 | EXTENDED_FLAG, 8)], 0.001, 1_000_000).bits == 160


def test_a_set_that_cannot_fit() -> None:
    assert cycle_load(DESIGN, 0.001, 1_000_000).fraction > 1
    assert cycle_load(DESIGN, 0.002, 500_000).fraction > 1


@pytest.mark.parametrize(("cycle_s", "bitrate"), [(0.0, 1_000_000), (0.002, 0), (-1.0, 1), (float("nan"), 1)])
def test_no_cycle_at_all(cycle_s: float, bitrate: int) -> None:
    with pytest.raises(ValueError, match="positive"):
        cycle_load(DESIGN, cycle_s, bitrate)
