"""Samples of the smallest web line: two axes, one load motor."""

from __future__ import annotations

from hilbench.topology.sample import sample_type
from hilbench.topology.signals import signals_of, smallest_shapes

SIGNALS = signals_of("web_line", smallest_shapes()["web_line"])
sample_of_two_axes = sample_type(SIGNALS)
