"""Kalman filter of E and unmodelled effects of a driven roller, on block means of its momentum balance; compiled.

    y = E·h + b + d·sign(v) + g·sign(v)·exp(-(v/v_s)²) + s·[v = 0] + c·v + k·T + μ·m·v' + u·cos φ + w·sin φ + D
        + E·S·(Σ_j a_j·p_j + b_j·q_j − κ'·q)

y: web force by measured torque and motion. D: an intermittent disturbance; offset b; dry friction d, and g beyond it at
low speed (Stribeck); s holds a roller at rest; viscous friction c; error k of the torque's scale (T: motor force);
error μ of the mass; unbalance u, w at the roller's angle φ; eccentricity a_j, b_j of the rollers over their radius
(p_j' = v/L·(cos φ_j − p_j), and q_j).

Creep κ takes κ·(F − F_next) from the strain as it builds up in the span, F being less by that itself. As κ' = κ/(1 +
E·S·κ) it is linear in what is measured: q' = v/L·(1 + E·S·κ)·(E·h − F_next − q). The state is κ', at the E that strains
are turned into forces with.

Identifiability: at constant speed and tension only the sum of all terms is measured; E and the rest are separated by
excitation alone. While speed or tension change, all states are estimated. In quiet time only those are whose regressors
separate them at all times (E, D, rotating terms); the others are considered (Schmidt–Kalman; Schmidt 1966): they keep
their mean, and count in every gain and in the stated deviation by their covariance. A regressor of measured
signals varies in quiet time by nothing but their noise, and would be taken for evidence in minutes (errors in
variables).

Wandering parameters stay within bounds: the variance added since the last excitation goes to that of an
Ornstein-Uhlenbeck process, of which it is the increment.
"""

from __future__ import annotations

from math import cos, exp, sin, sqrt

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import Record, compiled, inlined, noinline, record_type
from hilbench.estimation import noise_level
from hilbench.estimation.assumptions import CERTAIN, LATE, MOST_SQUARE, SHAKING
from hilbench.estimation.web_line import periodic_disturbance, unmodelled_evidence
from hilbench.estimation.web_line.unmodelled_evidence import EVIDENCE

# States; from OFFSET on unmodelled effects, from CREEP on those in the strain: times E.
E, DISTURBANCE, OFFSET, DRY, STRIBECK, STUCK, VISCOUS, SCALE, MASS, UNBALANCE_COS, UNBALANCE_SIN, CREEP = range(12)
COS2, SIN2, COS1, SIN1, STATES = range(12, 17)
#: Groups of effects that the model lacks together.
GROUPS = (
    (OFFSET,),
    (DRY, STRIBECK),
    (VISCOUS,),
    (SCALE, MASS),
    (CREEP,),
    (UNBALANCE_COS, UNBALANCE_SIN, COS2, SIN2, COS1, SIN1),
)


def _vectors(*names: str) -> list[tuple[str, str, tuple[int]]]:
    """Fields with a value of each state."""
    return [(name, "f8", (STATES,)) for name in names]


#: State of a filter. Forces at the web, angles in rad; E and what is relative to it over `reference_Pa`.
FILTER = np.dtype(
    [
        # Derived from model, config and cycle: cycles of a block; E·S at the reference E; usual tension; speed up to
        # which a roller may be at rest. Variances before anything is measured; random-walk variances, relative to
        # those, and their time constants; commissioned values: means of the prior.
        *record_type("cycle_s", "block", "mass_kg", "span_m", "reference_Pa", "stiffness_N").descr,
        *record_type("force_per_torque_per_m", "radius_1_m", "radius_2_m", "tension_N", "standstill_m_s").descr,
        *_vectors("prior", "wander", "wander_s", "base"),
        # Estimates: deviations from `base` and their covariance, of which `growth` is the random walk's.
        *_vectors("x", "growth"),
        ("covariance", "f8", (STATES, STATES)),
        # Parameters of the force correction, and their targets; the correction, its increase by parameter changes of
        # this cycle, without rotating terms, its deviation, and that for a web without tension.
        *_vectors("theta", "target"),
        *record_type("correction_N", "rebased_N", "spread_N", "intercept_N").descr,
        # Of this cycle and block: regressors, their sums, covariances of the innovation.
        *_vectors("now", "sums", "row"),
        *record_type("y_N", "count", "began_m_s").descr,
        # Motion, filtered; strain built up by creep; cosine and sine of the rollers' angles, as a strain of the span.
        *record_type("smooth_m_s", "usual_m_s", "directed_m_s", "acceleration_m_s2", "built_up_N").descr,
        ("wobble", "f8", (4,)),
        # Tension at the reference E: of the block before; means over the blocks before the last, and over more of them;
        # what regressors are formed with; its usual value, and mean square deviations from it and from `lagged_N`; time
        # since it was in transition, and left in which regressors are means since a jump of E.
        *record_type("web_before_N", "lagged_N", "mean_N", "regressor_N", "usual_web_N", "web_change_N2").descr,
        *record_type("lag_change_N2", "settled_s", "anew_s", "beyond_N").descr,
        # Share of the last block at rest; whether all states are estimated; how long the speed still counts as
        # changing, and the speed while it does not; time until the next evaluation of the evidence.
        *record_type("at_rest", "excited", "speeds_up_s", "steady_m_s", "evidence_s").descr,
        # Innovations: mean square over the expected; time since E jumped; whether at steady speed; time left to settle.
        *record_type("excess", "surprised", "leaning", "jumped_s", "was_steady", "settling_s").descr,
        # E that strains are turned into forces with; stated E, its lags, its variance.
        *record_type("modulus", "stated", "soon_before", "before", "unrest_N2", "stated_jumped").descr,
        *[(name, "f8", (noise_level.SIZE,)) for name in ("torque_noise", "position_noise")],
        ("orders", "f8", (periodic_disturbance.ORDERS, len(periodic_disturbance.ORDER.names or ()))),
        ("ripples", periodic_disturbance.KEPT),
        ("evidence", EVIDENCE),
    ]
)

#: Smoothing of the speed: of its sign, of the acceleration, and of what is usual, s.
_DIRECTION_S, _ACCELERATION_S, _USUAL_SPEED_S = 0.02, 0.1, 0.5
#: Deviation from the usual speed from which on it is changing: far above the noise of an encoder, and less than 1 % of
#: line speeds, m/s.
_SAME_SPEED_M_S = 0.01
#: Share of a block in which a roller is at rest, below which it starts.
_STARTS = 0.9
#: Averaging time of the tension, s; it is changing where it deviates from its mean certainly, and by this share of
#: itself; averaging time of the deviation, s.
_MEAN_S, _LEAST_CHANGE, _CHANGE_S = 5.0, 0.01, 60.0
#: A tension that deviates from the mean of the previous blocks by more, and by more than usual, is in transition: the
#: separation of creep and scale then depends on a timing that no measurement resolves.
_TRANSITION = 0.005
#: Settling time of the loops, s: for so long after it data count for a change of speed, from then on for one of the
#: tension. Behind a jump of E nothing is learned before, from a torque and a motion that swing.
_SETTLES_S = 0.3
#: Speed at which friction at the onset has vanished (Stribeck), m/s.
STRIBECK_M_S = 0.25
#: Change of speed that changes friction as much as its time constant does, m/s.
_OTHER_FRICTION_M_S = 3.0
#: Time over which the tension of the blocks before is averaged, s: far above a block, below the span's transport; and
#: where it is a regressor, and shows excitation: of what turns with a roller (2.4 Hz at 3 m/s and 0.2 m) a quarter is
#: left, as an unbalance is no evidence of friction.
_LAG_S, _REGRESSOR_S = 0.1, 0.3
#: Relative change of E from which on strain errors are converted to forces anew.
_OTHER_MODULUS = 0.02
#: Least share of the tension left by creep: far less than a running web keeps.
_LEAST_LEFT = 0.1
#: Memory of an intermittent force, s. Factor on the variance seen beyond the least: half of an oscillation at 0.3 Hz is
#: seen, and it stays in phase for longer than the memory. With 2 to 8 the intervals hold with ±3 N added; without it
#: friction or offset are found where there are none.
_DISTURBANCE_S, _SWAYS = 1.0, 3.0
#: Random walk of E, relative per √s: while all is estimated, and in quiet time, where it adds no information.
_WALK, _QUIET_WALK = 1e-3, 4e-3
#: Share of the force holding a roller at rest that counts as noise between rest and turning.
_PRESLIDING = 0.25
#: A mean of the innovations over so many blocks, beyond so many deviations of it, is no noise.
_LEANS, _LEANING_BLOCKS = 5.0, 25.0
#: By how much E may have changed then, relative.
_JUMP, _SMALL_JUMP = 0.3, 0.03
#: Memory of the innovations' size, s, and the most that one counts of it.
_EXCESS_S, _MOST_EXCESS = 2.0, 30.0
#: Time constants of the earlier stated E, s; it jumps when it differs from the short one certainly, and by this share
#: of itself, at the soonest the second one after a jump.
_SOON_S, _BEFORE_S, _USUAL_S, _LEAST_JUMP = 0.1, 0.5, 5.0, 0.02
#: Deviation of a force that comes and goes at least, relative to the tension.
_LEAST_UNREST = 4e-3
#: Time constant with which accepted effects are compensated, s.
_APPLIED_S = 0.25
#: Interval of the evaluation of the evidence, s.
_EVIDENCE_S = 0.5


@inlined
def _turns(i: int) -> bool:
    return i >= COS2 or i in (UNBALANCE_COS, UNBALANCE_SIN)


@compiled
def interrupt(f: Record) -> None:
    """Discard the current block: a cycle is missing or unusable."""
    f.count = 0.0
    f.soon_before = f.before = 0.0
    f.ripples.count = 0.0


@inlined
def likely_deviation_N(f: Record) -> float:
    """Standard deviation of the force correction: posterior spread weighted by the probability of a model error.

    As far as that exceeds the prior probability, `intercept_N` counts: the spread for a web without tension, as a
    change of the tension reveals it.
    """
    lacking, before = f.evidence.lacking, 1.0 - (1.0 - unmodelled_evidence.LACKING) ** unmodelled_evidence.GROUPS
    shows = 1.0 if f.evidence.accepted != 0 else min(max((lacking - before) / (1.0 - before), 0.0), 1.0)
    return float(shows * f.intercept_N + (1.0 - shows) * f.spread_N * sqrt(lacking))


@compiled
def forget(f: Record) -> None:
    """Reset unmodelled effects to their prior, none of them accepted; E keeps its mean, with the variance of a jump."""
    noinline()
    f.covariance[E, E] += _JUMP * _JUMP
    for i in range(STATES):
        if i == E:
            continue
        f.x[i] = 0.0
        f.growth[i] = 0.0
        for j in range(STATES):
            f.covariance[i, j] = f.covariance[j, i] = 0.0
        f.covariance[i, i] = f.prior[i]
        f.target[i] = 0.0
    f.evidence.accepted = 0
    f.excess = f.leaning = f.surprised = f.count = 0.0


@compiled
def _regressors(f: Record, web_N: float, speed_m_s: float, motor_N: float, phi_1: float, phi_2: float) -> None:
    """Regressors: force per unit of each state at this instant; states in the strain at the reference E."""
    a, inertia_N, changes = f.now, 0.0, f.speeds_up_s > 0.0
    if changes:
        inertia_N = f.mass_kg * f.acceleration_m_s2
    else:
        speed_m_s = f.steady_m_s
    direction = min(max(f.directed_m_s / f.standstill_m_s, -1.0), 1.0)
    a[E], a[DISTURBANCE], a[OFFSET] = web_N, 1.0, 1.0
    a[DRY] = direction
    a[STRIBECK] = direction * exp(-((speed_m_s / STRIBECK_M_S) ** 2))
    a[STUCK] = 1.0 - abs(direction)
    a[VISCOUS] = speed_m_s
    a[SCALE] = motor_N + inertia_N
    a[MASS] = inertia_N
    a[UNBALANCE_COS], a[UNBALANCE_SIN] = cos(phi_2), sin(phi_2)
    a[CREEP] = -f.stiffness_N * f.built_up_N
    for j in range(4):
        a[COS2 + j] = f.stiffness_N * f.wobble[j]


@inlined
def _lost(f: Record) -> float:
    """Share of a tension change lost by creep: E·S·κ'."""
    return float(f.modulus * f.stiffness_N * (f.base[CREEP] + f.x[CREEP]))


@inlined
def _left(f: Record) -> float:
    """Share of a tension change left by creep: 1/(1 + E·S·κ) = 1 − E·S·κ'."""
    return float(max(1.0 - _lost(f), _LEAST_LEFT))


@compiled
def _use_modulus(f: Record, modulus: float) -> None:
    """Set the E (over its reference) that converts strains to forces: the same creep κ has another κ' then."""
    noinline()
    ratio = 1.0 + (modulus / f.modulus - 1.0) * (1.0 - _left(f))
    f.modulus = modulus
    slope = 1.0 / (ratio * ratio)  # of κ' by κ', at a κ
    for i in range(STATES):
        f.covariance[CREEP, i] *= slope
    for i in range(STATES):
        f.covariance[i, CREEP] *= slope
    f.growth[CREEP] *= slope * slope
    for each in (f.base, f.x, f.theta, f.target):
        each[CREEP] /= ratio


@compiled
def force_of(a: Array, theta: Array, modulus: float, turning: bool) -> float:
    """Force of unmodelled effects: theta (STATES,) by regressors a (STATES,), at E over its reference, N. With or
    without rotating terms."""
    total = 0.0
    for i in range(OFFSET, STATES):
        if turning or not _turns(i):
            total += a[i] * theta[i] * (modulus if i >= CREEP else 1.0)
    return total


@compiled
def _predict(f: Record, duration_s: float, changed_m_s: float) -> None:
    """Predict over a block: random walk of E, decaying disturbance, bounded random walks of the other states."""
    p, walk = f.covariance, _WALK if f.excited != 0.0 else _QUIET_WALK
    p[E, E] += walk * walk * duration_s
    keep = exp(-duration_s / _DISTURBANCE_S)
    f.x[DISTURBANCE] *= keep
    for i in range(STATES):
        p[DISTURBANCE, i] *= keep
        p[i, DISTURBANCE] *= keep
    sways_N2 = _SWAYS * (f.unrest_N2 - least_unrest_N2(f.tension_N))
    p[DISTURBANCE, DISTURBANCE] += (1.0 - keep * keep) * (f.unrest_N2 + sways_N2)
    for i in range(OFFSET, STATES):
        if f.wander[i] == 0.0 or f.prior[i] == 0.0:
            continue
        ages = duration_s / f.wander_s[i]
        if i in (DRY, VISCOUS):
            ages += changed_m_s / _OTHER_FRICTION_M_S
        most = f.wander[i] * max(f.prior[i], f.x[i] * f.x[i])
        more = max(most - f.growth[i], 0.0) * (1.0 - exp(-2.0 * ages))
        f.growth[i] += more
        p[i, i] += more


@compiled
def _innovation(f: Record, y_N: float) -> float:
    """Innovation of a block mean, N; its covariances with the states go into `row`. The tension's deviation from its
    regressor is subtracted at the estimate of E: the regressor is then free of the block's noise, and the innovation of
    the regressor's lag."""
    x, p, row = f.x, f.covariance, f.row
    expected_N = 0.0
    for i in range(STATES):
        known = x[i] if i < OFFSET else f.base[i] + x[i]
        expected_N += _slope(f, i) * known
        total = 0.0
        for j in range(STATES):
            total += _slope(f, j) * p[i, j]
        row[i] = total
    return float(y_N - x[E] * (f.sums[E] - f.regressor_N) - expected_N)


@inlined
def _slope(f: Record, i: int) -> float:
    """Force per unit of a state in this block, free of the block's noise: the tension is that of previous blocks, and
    states in the strain use an E that does not follow the estimate's noise."""
    if i == E:
        return float(f.regressor_N)
    return float(f.sums[i] * f.modulus) if i >= CREEP else float(f.sums[i])


@compiled
def _spread(f: Record) -> float:
    """Variance of the innovation without measurement noise, by `row`, N²."""
    total = 0.0
    for j in range(STATES):
        total += _slope(f, j) * f.row[j]
    return float(total)


@inlined
def _is_estimated(i: int, excited: bool) -> bool:
    return excited or i in (E, DISTURBANCE) or _turns(i)


@compiled
def _correct(f: Record, innovation_N: float, variance_N2: float, excited: bool) -> None:
    """Schmidt–Kalman update: estimated states; considered ones keep mean and covariance (Joseph form with zero
    gain)."""
    x, p, row = f.x, f.covariance, f.row
    for i in range(STATES):
        if not _is_estimated(i, excited):
            continue
        gain, before = row[i] / variance_N2, p[i, i]
        x[i] += gain * innovation_N
        for j in range(STATES):
            if _is_estimated(j, excited) and j > i:
                continue  # symmetric: done when it is j's turn
            p[i, j] -= gain * row[j]
            p[j, i] = p[i, j]
        if before > 0.0:
            f.growth[i] *= p[i, i] / before


@compiled
def _block(f: Record, y_N: float, noise_N2: float, duration_s: float) -> None:
    """Update by a block's means, unless the innovation is an outlier: E has jumped if the next one is, too."""
    innovation_N = _innovation(f, y_N)
    variance_N2 = _spread(f) + noise_N2
    size = innovation_N / sqrt(variance_N2)
    f.jumped_s += duration_s
    f.excess += duration_s / _EXCESS_S * (min(size * size, _MOST_EXCESS) - f.excess)
    if f.surprised == 0.0:
        f.was_steady = 1.0 if f.speeds_up_s == 0.0 else 0.0
    if abs(size) > CERTAIN and f.surprised == 0.0:
        f.surprised = 1.0
        return
    freed, settling = 0.0, f.settling_s > 0.0
    f.settling_s = max(f.settling_s - duration_s, 0.0)
    if abs(size) > CERTAIN or f.stated_jumped != 0.0:
        freed, f.jumped_s = _JUMP, 0.0
        f.settling_s = _SETTLES_S * f.was_steady
    else:
        f.leaning += (size - f.leaning) / _LEANING_BLOCKS
        if abs(f.leaning) > _LEANS / sqrt(2.0 * _LEANING_BLOCKS):
            freed = _SMALL_JUMP
        if settling and f.settling_s == 0.0:  # what the loops' transient showed of E is off by more than noise
            freed = _JUMP
    f.surprised = 0.0
    if freed != 0.0:
        f.covariance[E, E] += freed * freed
        f.leaning = 0.0
        if f.settling_s > 0.0 or settling:
            f.regressor_N, f.anew_s = f.sums[E], _MEAN_S - duration_s
        innovation_N = _innovation(f, y_N)
        variance_N2 = _spread(f) + noise_N2
    _correct(f, innovation_N, variance_N2, f.excited != 0.0 and f.settling_s == 0.0)


@compiled
def _look_for_excitation(f: Record, web_N: float, duration_s: float) -> None:
    """Detect excitation: changes of speed or tension beyond noise and their usual size; select the regressors' tension
    and speed, in quiet time means over seconds, which are free of a block's noise."""
    f.mean_N += duration_s / (_REGRESSOR_S + duration_s) * (web_N - f.mean_N)
    apart_N = f.mean_N - f.usual_web_N
    least_N2 = (_LEAST_CHANGE * f.tension_N / CERTAIN) ** 2
    change_N2 = max(f.web_change_N2, least_N2)
    tension_changes = abs(apart_N) > CERTAIN * sqrt(change_N2) and abs(apart_N) > _LEAST_CHANGE * abs(web_N)
    f.web_change_N2 += duration_s / _CHANGE_S * (min(apart_N * apart_N, MOST_SQUARE * change_N2) - f.web_change_N2)
    f.usual_web_N += duration_s / (_MEAN_S + duration_s) * apart_N
    f.speeds_up_s = max(f.speeds_up_s - duration_s, 0.0)
    starts = abs(f.usual_m_s) <= f.standstill_m_s and f.sums[STUCK] < _STARTS
    if starts or abs(f.smooth_m_s - f.usual_m_s) > _SAME_SPEED_M_S:
        f.speeds_up_s = _SETTLES_S
    if f.speeds_up_s > 0.0:
        f.steady_m_s = f.usual_m_s
    f.steady_m_s += duration_s / (_MEAN_S + duration_s) * (f.usual_m_s - f.steady_m_s)
    lag_N = web_N - f.lagged_N
    lag_N2 = max(f.lag_change_N2, (_TRANSITION * f.tension_N / CERTAIN) ** 2)
    f.settled_s = f.settled_s + duration_s if abs(lag_N) < CERTAIN * sqrt(lag_N2) else 0.0
    f.lag_change_N2 += duration_s / _MEAN_S * (min(lag_N * lag_N, MOST_SQUARE * lag_N2) - f.lag_change_N2)
    f.excited = 1.0 if f.speeds_up_s > 0.0 or (tension_changes and f.settled_s > _SETTLES_S) else 0.0
    f.lagged_N += duration_s / (_LAG_S + duration_s) * (f.web_before_N - f.lagged_N)
    f.web_before_N = web_N
    if f.anew_s > 0.0:  # since E has jumped
        f.anew_s = max(f.anew_s - duration_s, 0.0)
        f.regressor_N += duration_s / (_MEAN_S - f.anew_s) * (web_N - f.regressor_N)
    else:
        f.regressor_N = f.mean_N if tension_changes or f.speeds_up_s > 0.0 else f.usual_web_N


@compiled
def _noise_N2(f: Record, web_N: float, acceleration_m_s2: float) -> float:
    """Variance of a block's mean: torque and encoder noise, vibration, presliding, timing of torque and motion."""
    n, dt = f.block, f.cycle_s
    position_m2 = noise_level.variance(f.position_noise)
    white_N2 = f.force_per_torque_per_m**2 * noise_level.variance(f.torque_noise)
    white_N2 += 2.0 * (f.stiffness_N / f.span_m) ** 2 * position_m2
    shaking_N = SHAKING * f.mass_kg * (f.acceleration_m_s2 - acceleration_m_s2)
    presliding_N = _PRESLIDING * sqrt(f.prior[STUCK]) * (1.0 - abs(2.0 * f.sums[STUCK] - 1.0))
    late_N = LATE * (web_N - f.web_before_N)
    edges_N2 = 4.0 * position_m2 * (f.mass_kg / (n * dt * dt)) ** 2
    return float((white_N2 / n + edges_N2 + shaking_N**2 + presliding_N**2 + late_N**2) * max(f.excess, 1.0))


@compiled
def _end_block(f: Record, speed_m_s: float) -> None:
    """Update the filter by the means of a complete block."""
    duration_s = f.block * f.cycle_s
    for j in range(STATES):
        f.sums[j] /= f.block
    acceleration_m_s2 = (speed_m_s - f.began_m_s) / duration_s
    y_N = f.y_N / f.block - f.mass_kg * acceleration_m_s2
    web_N, at_rest = f.sums[E], f.sums[STUCK]
    if f.usual_web_N == 0.0:
        f.usual_web_N = f.lagged_N = f.mean_N = f.web_before_N = f.regressor_N = web_N
    noise_N2 = _noise_N2(f, web_N, acceleration_m_s2)
    _look_for_excitation(f, web_N, duration_s)
    if at_rest > 0.5 and f.at_rest <= 0.5:  # the force that holds a roller at rest differs each time
        f.x[STUCK] = 0.0
        for j in range(STATES):
            f.covariance[STUCK, j] = f.covariance[j, STUCK] = 0.0
        f.covariance[STUCK, STUCK] = f.prior[STUCK]
    f.at_rest = at_rest
    if f.x[E] > 0.0 and abs(f.x[E] - f.modulus) > _OTHER_MODULUS * f.modulus:
        _use_modulus(f, f.x[E])
    _predict(f, duration_s, abs(speed_m_s - f.began_m_s))
    _block(f, y_N, noise_N2, duration_s)
    f.evidence_s -= duration_s
    if f.evidence_s <= 0.0:
        f.evidence_s = _EVIDENCE_S
        unmodelled_evidence.look(f.evidence, f.x, f.covariance, f.prior, f.wander, f.target)
    share = 1.0 - exp(-duration_s / _APPLIED_S)
    for j in range(OFFSET, STATES):
        f.theta[j] += share * (f.base[j] + f.target[j] - f.theta[j])


@compiled
def _spread_N(f: Record, a: Array, modulus: float) -> float:
    """Root-mean-square deviation of the unmodelled force from the accepted one, by regressors a (STATES,), N. While
    nothing is accepted the filter's mean differs from it."""
    variance, apart = 0.0, 0.0
    for i in range(OFFSET, STATES):
        b = a[i] * (modulus if i >= CREEP else 1.0)
        apart += b * (f.x[i] - f.target[i])
        for j in range(OFFSET, STATES):
            variance += b * a[j] * (modulus if j >= CREEP else 1.0) * f.covariance[i, j]
    return sqrt(max(variance, 0.0) + f.unrest_N2 + apart * apart)


@inlined
def least_unrest_N2(tension_N: float) -> float:
    """Least variance of an intermittent force at a usual tension, N²."""
    return (_LEAST_UNREST * tension_N) ** 2


@compiled
def _look_at_stated(f: Record, web_N: float) -> None:
    """Track the variance of the stated E, and detect its jumps."""
    duration_s = f.block * f.cycle_s
    if f.before == 0.0:
        f.soon_before = f.before = f.stated
        f.stated_jumped = 0.0
        return
    least_N2 = least_unrest_N2(f.tension_N)
    jump_N, apart_N = abs(f.stated - f.soon_before) * web_N, (f.stated - f.before) * web_N
    jumps = jump_N > max(CERTAIN * sqrt(f.unrest_N2), _LEAST_JUMP * f.stated * web_N)
    f.stated_jumped = 1.0 if jumps and f.speeds_up_s == 0.0 and f.jumped_s > _BEFORE_S else 0.0
    more_N2 = min(apart_N * apart_N, MOST_SQUARE * f.unrest_N2) - f.unrest_N2
    f.unrest_N2 = max(f.unrest_N2 + duration_s / _USUAL_S * more_N2, least_N2)
    f.soon_before += duration_s / (_SOON_S + duration_s) * (f.stated - f.soon_before)
    f.before += duration_s / (_BEFORE_S + duration_s) * apart_N / web_N if web_N != 0.0 else 0.0


@compiled
def take(
    f: Record,
    x1_m: float,
    x2_m: float,
    torque_Nm: float,
    force_N: float,
    web_per_Pa: float,
    velocity_m_s: float,
    next_N: float,
    stated_Pa: float,
) -> None:
    """Take the balance of a cycle; update `correction_N`, `rebased_N` and `spread_N`."""
    noise_level.take(f.torque_noise, torque_Nm)
    noise_level.take(f.position_noise, x2_m)
    dt, web_N = f.cycle_s, web_per_Pa * f.reference_Pa
    f.stated = stated_Pa / f.reference_Pa
    slope = (velocity_m_s - f.smooth_m_s) / (_ACCELERATION_S + dt)
    f.smooth_m_s += slope * dt
    f.usual_m_s += (velocity_m_s - f.usual_m_s) * dt / _USUAL_SPEED_S
    f.directed_m_s += (velocity_m_s - f.directed_m_s) * dt / (_DIRECTION_S + dt)
    f.acceleration_m_s2 = slope
    f.rebased_N = 0.0
    ended = f.count >= f.block
    if ended:
        before_N = force_of(f.now, f.theta, f.stated, False)
        _end_block(f, velocity_m_s)
        f.rebased_N = force_of(f.now, f.theta, f.stated, False) - before_N
        f.beyond_N = force_of(f.now, f.x, f.modulus, False) + force_of(f.now, f.base, f.modulus, False)
        f.count = 0.0
    uncrept_N = (f.regressor_N if f.regressor_N != 0.0 else web_N) * f.modulus
    tension_N = uncrept_N - _lost(f) * f.built_up_N
    motor_angle = x2_m * f.force_per_torque_per_m
    phi_1, phi_2 = x1_m / f.radius_1_m, x2_m / f.radius_2_m
    # Motor force without inertia, by the model: free of the noise of the measured torque.
    resistance_N = torque_Nm * f.force_per_torque_per_m + next_N - force_N
    _regressors(f, web_N, velocity_m_s, tension_N + resistance_N - next_N, phi_1, phi_2)
    if f.count == 0.0:
        f.began_m_s, f.y_N = velocity_m_s, 0.0
        for j in range(STATES):
            f.sums[j] = 0.0
    for j in range(STATES):
        f.sums[j] += f.now[j]
    expected_N = web_N * f.x[E] + f.beyond_N
    changed = periodic_disturbance.look(
        f.orders, f.ripples, force_N, expected_N, velocity_m_s, motor_angle, f.mass_kg, dt
    )
    ripple_N = periodic_disturbance.ripple_N(f.orders, motor_angle)
    f.y_N += force_N - ripple_N
    f.count += 1.0
    # Mass transport of creep and eccentricity strains through the span, per unit of each.
    share = min(abs(velocity_m_s) * dt / f.span_m, 1.0)
    f.built_up_N += min(share / _left(f), 1.0) * (web_N * f.modulus - next_N - f.built_up_N)
    f.wobble[0] += share * (cos(phi_2) - f.wobble[0])
    f.wobble[1] += share * (sin(phi_2) - f.wobble[1])
    f.wobble[2] += share * (cos(phi_1) - f.wobble[2])
    f.wobble[3] += share * (sin(phi_1) - f.wobble[3])
    if ended:
        # The deviation of the force correction now, and for a web without tension.
        f.spread_N = _spread_N(f, f.now, f.stated)
        for i in range(STATES):
            f.row[i] = 0.0 if i < OFFSET or _turns(i) else f.now[i]
        f.row[SCALE] -= tension_N
        f.row[CREEP] = f.stiffness_N * (tension_N - f.built_up_N)
        f.intercept_N = _spread_N(f, f.row, f.stated)
        _look_at_stated(f, web_N)
    f.correction_N = force_of(f.now, f.theta, f.stated, True) + ripple_N
    if changed:
        forget(f)
