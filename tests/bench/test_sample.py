"""The sample of a cycle has the signals of its bench."""

from dataclasses import fields

from tests.bench.samples import SIGNALS, sample_of_two_axes

from hilbench.topology.sample import sample_type
from hilbench.topology.signals import SMALLEST, Shape, signals_of


def test_a_sample_has_exactly_the_recorded_signals_and_the_cycle():
    assert [field.name for field in fields(sample_of_two_axes)] == ["cycle", *(signal.name for signal in SIGNALS)]


def test_integers_in_the_registry_are_integers_in_the_sample():
    sample = sample_of_two_axes()
    whole = {field.name for field in fields(sample) if isinstance(getattr(sample, field.name), int)} - {"cycle"}
    assert whole == {signal.name for signal in SIGNALS if signal.integer}


def test_benches_with_the_same_signals_share_a_class_and_others_have_their_own():
    assert sample_type(signals_of("web_line", SMALLEST["web_line"])) is sample_of_two_axes
    larger = sample_type(signals_of("web_line", Shape(3, ("first", "second"), 2, (1, 2), (1, 2))))()
    larger.tau_second_Nm, larger.F2_sim_N = 1.0, 2.0
    assert not hasattr(sample_of_two_axes(), "F2_sim_N")
