"""What can't be diagnosed is said in one line, and nothing is guessed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tests.plant.models import effect, lone_axis, model
from tests.simulated_recordings import hidden_recording

from hilbench.diagnosis.diagnosis import diagnose
from hilbench.diagnosis.measured import measured_from
from hilbench.errors import UnusableInputError
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import required_torque_Nm
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording

Channels = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def good() -> Channels:
    return dict(hidden_recording(model(), [], duration_s=12.0).channels)


def without(name: str) -> Callable[[Channels], Channels]:
    return lambda c: {key: values for key, values in c.items() if key != name}


def scaled(name: str, factor: float) -> Callable[[Channels], Channels]:
    return lambda c: {**c, name: c[name] * factor}


def exchanged(one: str, other: str) -> Callable[[Channels], Channels]:
    return lambda c: {**c, one: c[other], other: c[one]}


def both(one: Callable[[Channels], Channels], other: Callable[[Channels], Channels]) -> Callable[[Channels], Channels]:
    return lambda c: other(one(c))


def mostly_no_number(c: Channels) -> Channels:
    torque = c["tau2_Nm"].copy()
    torque[::2] = np.nan
    return {**c, "tau2_Nm": torque}


def twice(c: Channels) -> Channels:
    """Two recordings in one file: the clock starts anew."""
    shifted = {**c, "t_s": c["t_s"] + 0.001, "tau2_Nm": c["tau2_Nm"] + 0.5}
    return {name: np.concatenate([values, shifted[name]]) for name, values in c.items()}


def first_roller_of_another_recording(c: Channels) -> Channels:
    other = hidden_recording(model(), [], duration_s=12.0, seed=8, top_m_s=3.0).channels
    return {**c, **{name: other[name] for name in ("x1_m", "v1_m_s")}}


def slow_and_in_per_cent(c: Channels) -> Channels:
    """Torques in per cent of the drive's 9 N·m, of a run in which they stay below its limit all the same."""
    slow = hidden_recording(model(), [], duration_s=12.0, top_m_s=1.0).channels
    return {**slow, "tau2_Nm": slow["tau2_Nm"] / 0.09}


def short(c: Channels) -> Channels:
    return {name: values[:400] for name, values in c.items()}


def rows(count: int) -> Callable[[Channels], Channels]:
    return lambda c: {name: values[:count] for name, values in c.items()}


def quiet(c: Channels) -> Channels:
    noise = {name: values - values.mean() for name, values in c.items() if name[0] in "xv" and "cmd" not in name}
    still = {name: np.random.default_rng(0).normal(0.0, 1e-7, len(v)) for name, v in noise.items()}
    zero = {name: np.zeros(len(c["t_s"])) for name in ("v1_cmd_m_s", "v2_cmd_m_s")}
    return {**c, **still, **zero}


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (both(without("v1_cmd_m_s"), both(without("x2_m"), without("v2_m_s"))), "v1_cmd_m_s, v2_m_s missing"),
        (without("strain_prev"), "channel strain_prev missing"),
        (without("t_s"), "say which columns are which channels with 'hilbench convert --columns'"),
        (mostly_no_number, "channel tau2_Nm has 3000 value(s) that are no finite number"),
        (twice, "t_s starts over in sample 6001 (from 11.998 to 0.001 s)"),
        (scaled("v2_m_s", 60.0 / (2.0 * np.pi)), "v2_m_s is 9.549 times the rate of x2_m, as if v2_m_s were in rpm"),
        (scaled("v1_m_s", 1000.0), "as if v1_m_s were in mm/s, expected SI units: say so with 'hilbench convert"),
        (scaled("x1_m", 1.0 / (2.0 * np.pi)), "x1_m: {column: x1_m, factor: 6.28319}"),
        (scaled("v1_m_s", 3.1), "expected both in the same unit, of the same axis"),
        (short, "expected at least 5 s"),
        (rows(2499), "4.998 s long, expected at least 5 s"),
        (quiet, "nothing moves"),
        (scaled("t_s", 1000.0), "channel t_s: samples 2 s apart"),
        (scaled("x2_m", 1000.0), "as if x2_m were in mm, expected SI units"),
        (both(scaled("x2_m", 1000.0), without("v2_m_s")), "channel x2_m moves"),
        (scaled("v2_cmd_m_s", 60.0), "reaches"),
        (scaled("tau1_Nm", 1000.0), "expected N·m within the drive's limit of 9"),
        (scaled("strain_prev", 1e6), "channel strain_prev reaches"),
        (scaled("tau2_Nm", 0.0), "channel tau2_Nm never changes"),
        (scaled("v1_m_s", 0.0), "channel v1_m_s moves 0 while v1_cmd_m_s says"),
        (scaled("v1_m_s", 25.0 * 60.0 / (2.0 * np.pi)), "as if v1_m_s were in rpm of the motor, expected SI units"),
        (scaled("v1_m_s", 5.0), "as if v1_m_s were in rad/s of the roller, expected SI units"),
        (both(scaled("x2_m", 25.0), scaled("x1_m", 25.0)), "x1_m were in rad of the motor"),
        (both(scaled("x2_m", -1.0), scaled("v2_m_s", -1.0)), "by 200 % of the way apart, expected one web"),
        (both(scaled("tau1_Nm", -1.0), scaled("tau2_Nm", -1.0)), "tau1_Nm is -0.989 times the torque"),
        (slow_and_in_per_cent, "times the torque that accelerates axis 2 by the model, expected N·m of the motor"),
        (first_roller_of_another_recording, "channels x1_m and x2_m move"),
        (both(scaled("tau1_Nm", 1e-3), scaled("tau2_Nm", 1e-3)), "by the model, as if it were in kN·m, expected N·m"),
        (exchanged("tau1_Nm", "tau2_Nm"), "tau1_Nm is the torque that axis 2 needs by the model and tau2_Nm that of"),
        (scaled("strain_prev", 100.0), "as if it were in %, expected a strain (1): say so with 'hilbench convert"),
        (scaled("F_next_N", 1e-3), "channel F_next_N is 0.001 times the 70 of the model, as if it were in kN"),
    ],
)
def test_it_is_named(good: Channels, damage: Callable[[Channels], Channels], said: str) -> None:
    with pytest.raises(UnusableInputError) as caught:
        measured_from(Recording(damage(good)), model(), "run.csv")
    text = str(caught.value)
    assert said in text
    assert text.startswith("run.csv")
    assert "\n" not in text


def test_no_torque_at_all_is_refused_and_one_missing_is_gone_without(good: Channels) -> None:
    one = without("tau1_Nm")(good)
    with pytest.raises(UnusableInputError, match="expected at least one torque"):
        measured_from(Recording(without("tau2_Nm")(one)), model(), "run.csv")
    found = diagnose(Recording(one), model(), "run.csv")
    assert found.verdict == "complete"
    assert found.missing_channels == ["tau1_Nm"]
    assert [g.signal for g in found.gaps] == ["tau2_Nm"]


def test_a_recording_that_lacks_the_rollers_of_its_model_and_a_web_without_drives_are_refused(good: Channels) -> None:
    from tests.plant.models import line_of

    with pytest.raises(UnusableInputError, match="tau3_Nm missing, expected the commands of all axes"):
        measured_from(Recording(good), line_of(3), "run.csv")
    with pytest.raises(UnusableInputError, match="no 'drives'"):
        measured_from(Recording(good), model(drives=None), "run.csv")


def test_a_recording_of_as_many_rows_as_five_seconds_have_is_long_enough(good: Channels) -> None:
    assert measured_from(Recording(rows(2500)(good)), model(), "run.csv").duration_s == pytest.approx(4.998)


@pytest.mark.parametrize(
    "hidden", [effect("torque_offset", 1, offset_Nm=0.3), effect("torque_offset", 2, offset_Nm=-0.3)]
)
def test_torques_that_an_effect_brings_nearer_to_the_other_axis_are_not_taken_for_exchanged(hidden: dict) -> None:  # type: ignore[type-arg]
    recording = hidden_recording(model(), [EffectEntry.model_validate(hidden)], duration_s=12.0)
    assert measured_from(recording, model(), "run.csv").repairs == []


def test_an_axis_whose_angle_stands_for_its_position_may_turn_faster_than_a_web_goes() -> None:
    t = 0.002 * np.arange(4000)
    v = 198.0 * np.sin(1.3 * t)
    channels = {"t_s": t, "x1_m": np.cumsum(v) * 0.002, "v1_m_s": v, "tau1_Nm": np.gradient(v, 0.002) + np.sign(v)}
    turns = ModelParameters.model_validate(
        {"rollers": {"radius_m": 1.0, "inertia_kg_m2": 1.0, "gear_ratio": 1.0}, "motors": {"inertia_kg_m2": 0.0}}
    )
    assert measured_from(Recording(channels), turns, "run.csv").duration_s == pytest.approx(7.998)
    slides = turns.model_copy(update={"rollers": turns.rollers.model_copy(update={"radius_m": 0.1})})
    with pytest.raises(UnusableInputError, match="v1_m_s reaches 198, expected m/s up to 100"):
        measured_from(Recording(channels), slides, "run.csv")


def test_of_a_lone_axis_a_torque_in_kN_m_is_taken_and_said(good: Channels) -> None:
    t = 0.002 * np.arange(5000)
    v, a = np.sin(1.3 * t), 1.3 * np.cos(1.3 * t)
    torque = np.empty(len(t))
    required_torque_Nm(lay.pack(lone_axis()), -np.cos(1.3 * t) / 1.3, v, a, 0.002, torque)
    torque += 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    channels = {"t_s": t, "x1_m": -np.cos(1.3 * t) / 1.3, "v1_m_s": v}
    assert measured_from(Recording({**channels, "tau1_Nm": torque}), lone_axis(), "run.csv").repairs == []
    (said,) = measured_from(Recording({**channels, "tau1_Nm": 1e-3 * torque}), lone_axis(), "run.csv").repairs
    assert said.what == "unit"
    assert (
        "channel tau1_Nm is 0.001 times the torque that accelerates axis 1 by the model, as if it were in kN·m"
        in said.text
    )
