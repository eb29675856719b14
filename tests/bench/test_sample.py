"""The sample of a cycle and the list of a recording's signals say the same."""

from dataclasses import fields

from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import SIGNALS


def test_a_sample_has_exactly_the_recorded_signals_and_the_cycle():
    assert [field.name for field in fields(CycleSample)] == ["cycle", *(signal.name for signal in SIGNALS)]


def test_integers_in_the_list_are_integers_in_the_sample():
    whole = {field.name for field in fields(CycleSample) if field.type == "int"} - {"cycle"}
    assert whole == {signal.name for signal in SIGNALS if signal.integer}
