"""The list of signals is what the design promises to those who read recordings."""

from __future__ import annotations

import pytest
from tests.bench.samples import SIGNALS

from hilbench.topology.signals import Shape, find_signal, signals_of, smallest_shapes, unit_of

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


def test_every_part_has_its_own_signals_in_recording_order() -> None:
    names = [signal.name for signal in signals_of("web_line", Shape(3, ("first", "second"), 2, (1, 2), (1, 2)))]
    assert names[1:4] == ["v1_cmd_m_s", "v2_cmd_m_s", "v3_cmd_m_s"]
    assert {"tau_first_Nm", "x_second_m", "statusword_second", "E2_sim_Pa", "F1_true_N", "tau3_residual_Nm"} <= {*names}
    assert "F_sim_N" not in names
    assert len(set(names)) == len(names)


def test_a_servo_axis_has_the_signals_of_a_shaft_and_none_of_a_web() -> None:
    signals = {signal.name: signal for signal in signals_of("servo_axis", smallest_shapes()["servo_axis"])}
    assert {"x1_rad", "v1_cmd_rad_s", "tau_load_Nm", "x_load_rad", "J_sim_kg_m2", "tau1_residual_Nm"} <= {*signals}
    assert {signals[name].unit for name in ("J_sim_kg_m2", "J_sd_kg_m2", "J_true_kg_m2")} == {"kg·m²"}
    assert all("web" not in signal.description and "roller" not in signal.description for signal in signals.values())


EVERY_PART = (
    *signals_of("web_line", Shape(3, ("first", "second"), 2, (1, 2), (1, 2))),
    *signals_of("servo_axis", smallest_shapes()["servo_axis"]),
)


@pytest.mark.parametrize("signal", dict.fromkeys(EVERY_PART), ids=lambda signal: signal.name)
def test_a_signal_is_found_by_its_name_whatever_the_bench(signal) -> None:
    assert find_signal(signal.name) == signal


@pytest.mark.parametrize("name", ["x0_m", "F0_sim_N", "own_m_s", "v1", "x1_m_s_", "E1_sim"])
def test_a_name_of_no_part_is_no_signal(name: str) -> None:
    assert find_signal(name) is None
