"""Inverse dynamics of a line: the torques its drives report, and the tensions, for a measured motion of its axes.

No control loop is involved. The strain of a span follows from mass conservation by the travel at both of its rollers,
which encoders measure far better than speeds; each torque from the momentum balance of its roller.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import MATRIX, REAL, VECTOR, entry_point, inlined
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.sampling import on_all_cores
from hilbench.plant.web_line import laws, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import reported_torque_Nm, true_motion
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.parameters import ModelParameters

Array = NDArray[np.float64]


@inlined
def _pull_N(p: Vector, w: Vector, tension: int, i: int, n: int, upstream_N: float, downstream_N: float) -> float:
    """Force of the web on roller i, N forward."""
    if p[lay.W_SIZE + i * lay.A_SIZE + lay.A_WEB_LOAD] == 0.0:
        return 0.0
    before = w[tension + i - 1] if i > 0 else upstream_N
    return (w[tension + i] if i < n - 1 else downstream_N) - before


@inlined
def _parts(n: int) -> tuple[int, int, int, int, int, int]:
    """Offsets in the scratch space of a line of n rollers: web speeds, tensions, rates of the unstretched and of the
    nominal lengths, these lengths, factors of the steps of E."""
    k = n - 1
    return 0, n, n + k, n + 2 * k, n + 3 * k, n + 5 * k


@inlined
def _rates(
    p: Vector, s: Vector, n: int, t: float, strain_prev: float, next_N: float, w: Vector, travel_m: float, blur_m: float
) -> None:
    """Tensions and rates of the spans, in the scratch space `w`; `s`: pieces of other web."""
    speed, tension, rate, length_rate, material, steps = _parts(n)
    k, first = n - 1, lay.W_SIZE + n * (lay.A_SIZE + lay.M_SIZE)
    strain_next = laws.downstream_strain(p, next_N)
    if splice_laws.has_splice(p, s, 0):
        splice_laws.spliced_span_rates(
            p, s, 0, first, k, t, strain_prev, next_N, strain_next, w, steps, speed, material, length_rate, tension,
            rate, travel_m, blur_m,
        )  # fmt: skip
    else:
        laws.span_rates(
            p, first, k, t, strain_prev, next_N, strain_next, w, steps, speed, material, length_rate, tension, rate
        )


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
    n = x_m.shape[1]
    k = n - 1
    xs, vs, accelerations = np.empty_like(x_m), np.empty_like(x_m), np.empty_like(x_m)
    for i in range(n):
        motor = lay.W_SIZE + n * lay.A_SIZE + i * lay.M_SIZE
        for row in range(x_m.shape[0]):
            xs[row, i], vs[row, i], accelerations[row, i] = true_motion(
                p, motor, x_m[row, i], v_m_s[row, i], a_m_s2[row, i]
            )
    speed, tension, rate, _, material, steps = _parts(n)
    w, first_span = np.zeros(n + 6 * k), lay.W_SIZE + n * (lay.A_SIZE + lay.M_SIZE)
    s, blur = np.zeros(lay.PIECES_SIZE), lay.LEAST_BLUR_M
    begin, first = np.zeros(k), np.zeros(k)
    for j in range(k):
        w[material + k + j] = lengths[j]
        w[material + j] = lengths[j] * laws.length_factor(p, first_span + j * lay.SP_SIZE) / (1.0 + boundary[0, 0])
    for row in range(x_m.shape[0]):
        t = row * period_s
        laws.put_step_factors(p, first_span, k, t, period_s, w, steps)
        strain_prev = laws.upstream_strain(p, boundary[row, 0], t)
        downstream = boundary[row, 1]
        for i in range(n):
            w[speed + i] = laws.web_speed_m_s(p, lay.W_SIZE + i * lay.A_SIZE, xs[row, i], vs[row, i])
        travel = xs[row, 0]
        if splice_laws.has_splice(p, s, 0):
            blur = max(abs(vs[row, 0]) * period_s, lay.LEAST_BLUR_M)
            splice_laws.let_splice_in(p, s, 0, t, period_s, travel, vs[row, 0], strain_prev)
        _rates(p, s, n, t, strain_prev, downstream, w, travel, blur)
        for j in range(k):
            F_N[row, j] = w[tension + j]
            scale = laws.length_factor(p, first_span + j * lay.SP_SIZE)
            strain[row, j] = w[material + k + j] * scale / w[material + j] - 1.0
        upstream = strain_prev * p[lay.W_UPSTREAM_STIFFNESS_N]
        for i in range(n):
            axis, motor = lay.W_SIZE + i * lay.A_SIZE, lay.W_SIZE + n * lay.A_SIZE + i * lay.M_SIZE
            pull = _pull_N(p, w, tension, i, n, upstream, downstream)
            x, v, a = xs[row, i], vs[row, i], accelerations[row, i]
            direction = measured_direction(v, laws.FRICTION_WIDTH_M_S)
            tau_Nm[row, i] = reported_torque_Nm(p, axis, motor, t, x, v, a, a, pull, direction, 1.0)
        if row + 1 == x_m.shape[0]:
            break
        # To the next row by Heun's rule, with the web's travel instead of speeds: it is exact, whatever the period.
        for i in range(n):
            axis = lay.W_SIZE + i * lay.A_SIZE
            gone = xs[row + 1, i] - xs[row, i] + laws.eccentric_travel_m(p, axis, xs[row, i], xs[row + 1, i])
            w[speed + i] = gone / period_s
        for j in range(k):
            begin[j] = w[material + j]
        _rates(p, s, n, t, strain_prev, downstream, w, travel, blur)
        for j in range(k):
            first[j] = w[rate + j]
            w[material + j] = begin[j] + period_s * first[j]
        _rates(p, s, n, t, strain_prev, downstream, w, xs[row + 1, 0], blur)
        for j in range(k):
            w[material + j] = begin[j] + 0.5 * period_s * (first[j] + w[rate + j])
    rows = x_m.shape[0]
    for i in range(n):
        motor = lay.W_SIZE + n * lay.A_SIZE + i * lay.M_SIZE
        late = laws.reporting_delay_s(p, motor) / period_s
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
