"""Inverse dynamics of a line: the torques its drives report, and the tensions, for a measured motion of its axes.

No control loop is involved. The strain of a span follows from mass conservation by the travel at both of its rollers,
which encoders measure far better than speeds; each torque from the momentum balance of its roller.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sin

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import MATRIX, REAL, VECTOR, Vector, entry_point
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.sampling import on_all_cores
from hilbench.plant.web_line import laws, motion, records, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import reported_torque_Nm, true_motion
from hilbench.plant.web_line.layout import Layout
from hilbench.plant.web_line.parameters import ModelParameters


@entry_point(VECTOR, VECTOR, MATRIX, MATRIX, MATRIX, MATRIX, REAL, MATRIX, MATRIX, MATRIX)
def _required_torques(
    p: Vector,
    lengths: Vector,
    x_m: Vector,
    v_m_s: Vector,
    a_m_s2: Vector,
    boundary: Vector,
    period_s: float,
    tau_Nm: Vector,
    F_N: Vector,
    strain: Vector,
) -> None:
    n, k, rows = x_m.shape[1], x_m.shape[1] - 1, x_m.shape[0]
    xs, vs, accelerations = np.empty_like(x_m), np.empty_like(x_m), np.empty_like(x_m)
    line = records.of_parameters(p)
    for i in range(n):
        motor = records.motor(line, i)
        for row in range(rows):
            xs[row, i], vs[row, i], accelerations[row, i] = true_motion(
                motor, x_m[row, i], v_m_s[row, i], a_m_s2[row, i]
            )
    s, u = np.zeros(records.past(line, n) + lay.PIECES_SIZE), np.zeros(lay.U_MOTORS)
    w = np.zeros(records.block(line, lay.BLOCKS) + lay.CALL_SIZE + n * lay.PART_SIZE)
    line = records.line_of(p, s, u, w)
    web, pieces, around = records.web(line), records.pieces(line), records.boundary(line)
    y = records.block(line, lay.STAGE)
    material, begin, first = y + 4 * n, np.zeros(k), np.zeros(k)
    for j in range(k):
        w[material + k + j] = lengths[j]
        w[material + j] = lengths[j] * laws.length_factor(records.span(line, j)) / (1.0 + boundary[0, 0])
    records.call(line).blur_m = lay.LEAST_BLUR_M
    for row in range(rows):
        t = row * period_s
        laws.put_step_factors(line, t, period_s)
        around.strain_prev, around.F_next_N = boundary[row, 0], boundary[row, 1]
        strain_prev = motion.strain_prev(line, t)
        for i in range(n):
            records.part(line, i).speed_m_s = laws.web_speed_m_s(records.axis(line, i), xs[row, i], vs[row, i])
        if splice_laws.has_splice(web, pieces):
            records.call(line).blur_m = max(abs(vs[row, 0]) * period_s, lay.LEAST_BLUR_M)
            splice_laws.let_splice_in(web, pieces, t, period_s, xs[row, 0], vs[row, 0], strain_prev)
        motion.span_rates(line, t, strain_prev, material, xs[row, 0])
        for j in range(k):
            F_N[row, j] = records.part(line, j).tension_N
            strain[row, j] = laws.stretch(line, material, j) - 1.0
        for i in range(n):
            pull, v = motion.web_force_N(line, i, y, strain_prev, True), vs[row, i]
            direction, moved = measured_direction(v, laws.FRICTION_WIDTH_M_S), (xs[row, i], v, accelerations[row, i])
            tau_Nm[row, i] = reported_torque_Nm(line, i, t, moved, accelerations[row, i], pull, direction, 1.0)
        if row + 1 == rows:
            break
        # To the next row by Heun's rule, with the web's travel instead of speeds: it is exact, whatever the period.
        for i in range(n):
            x, end, off, gone = xs[row, i], xs[row + 1, i], records.axis(line, i).roller_eccentricity, 0.0
            if off.amplitude_m != 0.0:  # `laws.web_speed_m_s` integrated
                radius = records.axis(line, i).radius_m
                gone = off.amplitude_m * (sin(end / radius + off.phase_rad) - sin(x / radius + off.phase_rad))
            records.part(line, i).speed_m_s = (end - x + gone) / period_s
        begin[:] = w[material : material + k]
        motion.span_rates(line, t, strain_prev, material, xs[row, 0])
        for j in range(k):
            first[j] = records.part(line, j).rate_m_s
            w[material + j] = begin[j] + period_s * first[j]
        motion.span_rates(line, t, strain_prev, material, xs[row + 1, 0])
        for j in range(k):
            w[material + j] = begin[j] + 0.5 * period_s * (first[j] + records.part(line, j).rate_m_s)
    for i in range(n):
        late = records.motor(line, i).torque_delay.delay_s / period_s
        whole = int(late)
        share = late - whole
        for row in range(rows - 1, -1, -1):
            newer, older = max(row - whole, 0), max(row - whole - 1, 0)
            tau_Nm[row, i] = tau_Nm[newer, i] + share * (tau_Nm[older, i] - tau_Nm[newer, i])


@dataclass(frozen=True, slots=True)
class RequiredTorques:
    """Torques, tensions and strains for the measured motion; (B, n, axes or spans)."""

    tau_Nm: Array  #: as the drives report it, motor side
    F_N: Array
    strain: Array


def required_torques(
    parameters: Vector,
    model: ModelParameters,
    x_m: Array,
    v_m_s: Array,
    a_m_s2: Array,
    boundary: Array,
    period_s: float,
) -> RequiredTorques:
    """Torques required for the motion of a line's driven axes.

    parameters: (B, P) from `layout.pack`, shared out among all cores; model: for the lengths of the spans. x_m, v_m_s,
    a_m_s2: (n, axes) motion at the web, a row every `period_s`; boundary: (n, 2) upstream strain and downstream tension
    (N). The first row's strain is that of the web that enters.
    """
    many = np.ascontiguousarray(np.atleast_2d(parameters))
    layout = Layout.of(many[0])
    lengths = np.array([model.span_length_m(k + 1) for k in range(layout.spans)])
    x, v, a, around = (np.ascontiguousarray(values, dtype=np.float64) for values in (x_m, v_m_s, a_m_s2, boundary))
    tau = np.empty((len(many), len(x_m), layout.axes))
    force, strain = np.empty((2, len(many), len(x_m), layout.spans))

    def run(share: slice) -> None:
        for b in range(*share.indices(len(many))):
            _required_torques(many[b], lengths, x, v, a, around, period_s, tau[b], force[b], strain[b])

    on_all_cores(run, len(many))
    return RequiredTorques(tau, force, strain)
