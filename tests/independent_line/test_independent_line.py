"""The independent line against what is known of such a machine: it must be right where the product may be wrong."""

from __future__ import annotations

import numpy as np
import pytest
from tests.independent_line import PROFILES, STEP_OF_E, Line, Loops, effect
from tests.independent_line.spans import LineOfSpans

BELOW_LIMITS = Line(noise=0.0)


def settled(line: Line) -> dict[str, float]:
    """Means over the last seconds of a production run, at 3 m/s."""
    record = line.record("production", duration_s=16.0)
    rows = record.channels["t_s"] > 13.0
    everything = {**record.channels, **record.truth}
    return {name: float(np.mean(values[rows])) for name, values in everything.items()}


def test_at_constant_speed_the_tension_is_that_of_the_strain_and_torques_balance_it() -> None:
    found = settled(BELOW_LIMITS)
    assert found["F_true_N"] == pytest.approx(80.0, abs=1.0)  # the controller is slow
    assert found["F_true_N"] == pytest.approx(8.7e9 * 0.5 * 65e-6 * found["strain"], rel=1e-6)
    assert found["tau2_Nm"] == pytest.approx(0.04 * (found["F_true_N"] - 70.0), abs=1e-3)
    assert found["tau1_Nm"] == pytest.approx(0.04 * (80.0 - found["F_true_N"]), abs=1e-3)


def test_a_step_of_E_changes_the_tension_at_once_and_the_strain_when_the_rollers_give_way() -> None:
    step = effect("elasticity_step", time_s=8.001, relative_change=0.1)
    record = Line(noise=0.0, hidden=[step]).record("production", duration_s=9.0)
    before, after = np.flatnonzero(record.channels["t_s"] > 7.9995)[[0, 1]]
    tension, strain = record.truth["F_true_N"], record.truth["strain"]
    assert tension[after] == pytest.approx(1.1 * tension[before], rel=1e-2)
    assert strain[after] == pytest.approx(strain[before], rel=1e-2)
    assert np.ptp(strain[after : after + 50]) > 0.05 * strain[before]


@pytest.mark.parametrize(
    ("item", "torque_Nm"),
    [
        (effect("coulomb_friction", 2, force_N=4.0), 0.16),
        (effect("viscous_friction", 2, coefficient_N_s_per_m=2.0), 0.24),
        (effect("torque_offset", 2, offset_Nm=0.04), 0.04),
        (effect("quadratic_drag", 2, coefficient_N_s2_per_m2=0.5), 0.18),
        (effect("stribeck_friction", 2, force_N=4.0, speed_m_s=50.0), 0.16),
    ],
    ids=lambda item: item["effect"] if isinstance(item, dict) else "",
)
def test_what_resists_shows_in_the_torque_by_its_law(item: dict[str, object], torque_Nm: float) -> None:
    found = settled(Line(noise=0.0, hidden=[item]))
    needed = found["tau2_Nm"] - 0.04 * (found["F_true_N"] - 70.0)
    assert needed == pytest.approx(torque_Nm, rel=0.01)


def test_dry_friction_gives_way_elastically_before_it_slides() -> None:
    """Presliding: below the breakaway force a roller moves by micrometres, in proportion."""
    friction = effect("coulomb_friction", 2, force_N=10.0)
    moved = []
    for bristle in (1e5, 2e5):
        record = Line(noise=0.0, downstream_N=75.0, hidden=[friction], bristle_N_per_m=bristle).record(
            "production", duration_s=1.0
        )
        moved.append(float(np.max(np.abs(record.channels["x2_m"]))))
    assert 1e-6 < moved[1] < moved[0] < 1e-4


def test_drives_differ_by_their_loops_and_a_recording_by_its_rows() -> None:
    plain = BELOW_LIMITS.record("production", duration_s=8.0).channels
    slow = Line(noise=0.0, loops=Loops(kp=(0.7, 0.7), lag_s=(0.004, 0.004))).record("production", duration_s=8.0)
    error, slower = (np.max(np.abs(c["v2_m_s"] - c["v2_cmd_m_s"])) for c in (plain, slow.channels))
    assert slower > 1.2 * error
    coarse = Line(row_s=0.02, without=["x1_m", "v1_cmd_m_s"], measured_tension_N=0.5).record(
        "production", duration_s=8.0
    )
    assert np.allclose(np.diff(coarse.channels["t_s"]), 0.02)
    assert not {"x1_m", "v1_cmd_m_s"} & set(coarse.channels)
    assert np.std(coarse.channels["F_meas_N"] - coarse.truth["F_true_N"]) == pytest.approx(0.5, rel=0.2)


def test_jitter_of_the_rows_is_common_to_both_axes() -> None:
    steady, jittering = (Line(jitter_s=j).record("production", duration_s=12.0).channels for j in (0.0, 1e-4))
    error_m = [jittering[f"x{k}_m"] - steady[f"x{k}_m"] for k in (1, 2)]
    assert np.std(error_m[0][-1000:]) == pytest.approx(3e-4, rel=0.2)
    assert np.std((error_m[0] - error_m[1])[-1000:]) < 2e-6


@pytest.mark.parametrize("profile", PROFILES)
def test_the_same_line_records_the_same_bits(profile: str) -> None:
    one, two = (Line(hidden=[STEP_OF_E]).record(profile, seed=3, duration_s=6.0) for _ in range(2))
    other = Line(hidden=[STEP_OF_E]).record(profile, seed=4, duration_s=6.0)
    assert all(np.array_equal(one.channels[name], two.channels[name]) for name in one.channels)
    assert not np.array_equal(one.channels["tau2_Nm"], other.channels["tau2_Nm"])


def test_what_it_can_not_hide_it_says() -> None:
    with pytest.raises(ValueError, match="can't hide 'magic'"):
        Line(hidden=[effect("magic", 1)]).record("production", duration_s=2.0)


@pytest.mark.slow
def test_a_splice_passes_the_spans_one_after_the_other_as_a_spring_in_series() -> None:
    lengths = (2.5, 4.0, 3.0)
    splice = effect("splice", time_s=8.0, relative_change=1.0, length_m=0.5)
    with_it, without = (
        LineOfSpans(lengths_m=lengths, hidden=hidden, noise=0.0).record("production", duration_s=14.0)
        for hidden in ((splice,), ())
    )
    t = with_it.channels["t_s"]
    came = 8.0
    for span, length_m in enumerate(lengths, 1):
        name = f"F{span}_true_N"
        change = with_it.truth[name] / without.truth[name] - 1.0
        before, inside = t < came - 0.02, (t > came + 0.25 * length_m / 3.0) & (t < came + 0.5 * length_m / 3.0)
        assert np.max(np.abs(change[before & (t > 7.0)])) < 0.02 * (span - 1) + 1e-6
        # a tenth of the extension is gone while it comes in; rollers that give way and the time L/v let most of it go
        assert np.max(change[inside]) > 0.1 * 0.5 / length_m
        came += length_m / 3.0
