"""Natural frequencies of a line at standstill: rollers and carriages on the web, with the drives off."""

from __future__ import annotations

from math import ceil

import numpy as np

from hilbench.compiled import Vector
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout
from hilbench.plant.web_line.parameters import ModelParameters

#: Largest angle of the fastest mode per integration step; Runge-Kutta's error is then below 1e-4 a period.
_ANGLE_OF_A_STEP = 0.4


def natural_frequencies_rad_s(model: ModelParameters) -> Vector:
    """Natural frequencies of all axes of the kernel (n,), ascending: M·x'' = -K·x about the start.

    A span of stiffness E·S/L is between two rollers, and is stretched by the carriage of one of them.
    """
    p = lay.pack(model)
    layout = Layout.of(p)
    rows = layout.axis_rows(p)
    wound_kg = np.where(rows.reel_slope_per_m != 0.0, rows.wound_kg * (1.0 - rows.core_ratio**4), 0.0)
    mass = rows.motor_mass_kg + rows.roller_mass_kg + wound_kg
    stretch = np.zeros((layout.spans, layout.axes))
    for span in range(layout.spans):
        stretch[span, [span, span + 1]] = -1.0, 1.0
    for at, carriage in enumerate(model.carriages, layout.spans + 1):
        arm = carriage.station.arm_length_m
        gain = np.cos(carriage.station.position_m / arm) if arm else 1.0
        stretch[carriage.first_span - 1 : carriage.last_span, at] = gain
    per_m = [model.stiffness_N(span) / model.span_length_m(span) for span in range(1, layout.spans + 1)]
    stiffness = stretch.T @ (np.array(per_m)[:, np.newaxis] * stretch) + np.diag(rows.spring_N_per_m)
    scaled = stiffness / np.sqrt(np.outer(mass, mass))
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(scaled), 0.0)))


def needed_substeps(model: ModelParameters) -> int:
    """Integration steps per sample time of the drives for the fastest roller of a line of stations.

    One for a line of driven rollers alone: these are heavy.
    """
    if model.stations is None:
        return 1
    sample_s = model.drives.sample_time_s if model.drives else 0.001
    return max(ceil(float(natural_frequencies_rad_s(model)[-1]) * sample_s / _ANGLE_OF_A_STEP), 1)
