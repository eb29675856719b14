"""Samples of the smallest web line: two axes, one load motor."""

from __future__ import annotations

from hilbench.topology.sample import sample_type
from hilbench.topology.signals import SMALLEST, signals_of

SIGNALS = signals_of("web_line", SMALLEST["web_line"])
sample_of_two_axes = sample_type(SIGNALS)
