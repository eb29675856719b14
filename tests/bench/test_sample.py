"""The sample of a cycle has the signals of its bench."""

from copy import copy, deepcopy

import pytest
from tests.bench.samples import SIGNALS, sample_of_two_axes

from hilbench.topology.sample import sample_type
from hilbench.topology.signals import Shape, signals_of, smallest_shapes


def test_a_sample_has_exactly_the_recorded_signals_and_the_cycle():
    assert sample_of_two_axes.names() == [*(signal.name for signal in SIGNALS), "cycle"]
    with pytest.raises(AttributeError):
        sample_of_two_axes().F2_sim_N = 1.0


def test_integers_in_the_registry_are_integers_in_the_sample():
    sample = sample_of_two_axes()
    whole = {name for name in sample.names() if isinstance(getattr(sample, name), int)} - {"cycle"}
    assert whole == {signal.name for signal in SIGNALS if signal.integer}


def test_the_vectors_of_a_sample_are_its_signals():
    sample = sample_of_two_axes(F_sim_N=80.5, twin_status=3)
    assert sample.reals[sample.place("F_sim_N")] == 80.5
    assert sample.wholes[sample.places(["twin_status", "cycle"])].tolist() == [3, 0]
    sample.reals[sample.place("x1_m")] = 0.25
    sample.wholes[sample.place("cycle")] = 7
    assert (sample.x1_m, sample.cycle, sample_of_two_axes().x1_m) == (0.25, 7, 0.0)


@pytest.mark.parametrize("made", [copy, deepcopy])
def test_a_copy_stays_what_it_was(made):
    sample = sample_of_two_axes(F_sim_N=80.5, twin_status=3, cycle=7)
    kept = made(sample)
    sample.F_sim_N, sample.twin_status = 1.0, 0
    assert (kept.F_sim_N, kept.twin_status, kept.cycle) == (80.5, 3, 7)
    assert "F_sim_N=80.5" in repr(kept)


def test_benches_with_the_same_signals_share_a_class_and_others_have_their_own():
    assert sample_type(signals_of("web_line", smallest_shapes()["web_line"])) is sample_of_two_axes
    larger = sample_type(signals_of("web_line", Shape(3, ("first", "second"), 2, (1, 2), (1, 2))))()
    larger.tau_second_Nm, larger.F2_sim_N = 1.0, 2.0
    assert not hasattr(sample_of_two_axes(), "F2_sim_N")
