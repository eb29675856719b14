"""E of each span among the values that the steps of an experiment ask for."""

from __future__ import annotations

from collections.abc import Mapping

from hilbench.bench.tasks.emulated_web import emulated_web
from hilbench.runs.config import ExperimentConfig
from hilbench.topology.quantities import LINE_SPEED
from hilbench.topology.web_line_quantities import YOUNGS_MODULUS, is_modulus, spans_of_moduli, tension_set_point


def start_values(config: ExperimentConfig) -> dict[str, float]:
    """Values of the quantities of a line at the start, by path."""
    set_points = {
        tension_set_point(config.shape.numbered(span)): control.set_point_N
        for span, control in config.set_point_controls.items()
    }
    web = emulated_web(config.web_line, config.load)
    moduli_Pa = {path: web.youngs_modulus_Pa(span) for path, span in spans_of_moduli(config.shape).items()}
    return {LINE_SPEED: 0.0, **set_points, **moduli_Pa}


def changed(values: Mapping[str, float], path: str) -> dict[str, float]:
    """The values after that of `path` was given: E of all spans is that of each, whatever it was."""
    of_each = {known: values[path] for known in values if is_modulus(known)} if path == YOUNGS_MODULUS else {}
    return {**values, **of_each}
