"""The list of signals is what the design promises to those who read recordings."""

from __future__ import annotations

import pytest

from hilbench.topology.signals import SIGNALS, unit_of

DESIGN = [
    "t_s",
    "v1_cmd_m_s",
    "v2_cmd_m_s",
    "x1_m",
    "x2_m",
    "v1_m_s",
    "v2_m_s",
    "tau1_Nm",
    "tau2_Nm",
    "strain_prev",
    "F_next_N",
    "F_ref_N",
]


def test_the_designs_channels_come_first_and_no_name_twice() -> None:
    names = [signal.name for signal in SIGNALS]
    assert names[: len(DESIGN)] == DESIGN
    assert len(set(names)) == len(names)


def test_unit_agrees_with_the_suffix_of_the_name() -> None:
    assert all(unit_of(f"other_{signal.name}") == signal.unit for signal in SIGNALS if signal.unit != "bit")


@pytest.mark.parametrize(
    ("name", "unit"), [("x1_cmd_m", "m"), ("w_rad_s", "rad/s"), ("count", ""), ("tau3_Nm", "N·m"), ("bus_bits", "bit")]
)
def test_unit_of_any_channel(name: str, unit: str) -> None:
    assert unit_of(name) == unit
