"""Samples of the smallest web line: two axes, one load motor."""

from __future__ import annotations

from hilbench.topology.sample import sample_type
from hilbench.topology.signals import signals_of

SIGNALS = signals_of("web_line", 2, ["load"], 1)
sample_of_two_axes = sample_type(SIGNALS)
