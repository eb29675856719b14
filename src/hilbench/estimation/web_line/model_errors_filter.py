"""What the model may lack, beside E, in Kalman filters on block means of the momentum balance; compiled.

    y = E·h + b + d·sign(v) + s·[v = 0] + c·v + k·T + μ·m·v' + u·cos φ + w·sin φ + E·S·(Σ a_j·c_j + b_j·s_j − κ·q)

y: force that the web must pull with by measured torque and motion. Offset b, dry friction d, force s that keeps a
roller at rest, viscous friction c, error k of the torque's scale (T: force of the motor), error μ of the mass,
unbalance u and w at the roller's angle φ, creep κ (q: difference of the tensions around the roller, as it builds up in
the span: q' = v/L·(F − F_next − q)), and eccentricity over the radius, as it builds up by the rollers' angles:
c_j' = v/L·(cos φ_j − c_j), and s_j. A force that comes and goes (REST) is in all of them, and a share of what the
strain sways by about its mean at steady speed (SWAY): web that comes in may sway while a loop keeps its tension. Taken
for tension, that would make E seem the smaller the longer it lasts. Where it swings (`swings`), a share of what the
strain does more quickly than its mean over some tenths of a second is another (QUICK): with SWAY, which lags behind it,
it is whatever a swing of one frequency does.

There is a filter for every subset of the groups of such errors, all on the same blocks, weighed by their evidence
(Bayesian model averaging). E jumps in all of them when the filter of all groups is surprised, so that a change of E
says nothing of what is constant beside it; and so it does when E that is told jumps while the roller turns steadily: a
step that is lost in what such a block may be off by.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, exp, log, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import CUBE, MATRIX, TABLE, VECTOR, compiled, entry_point, inlined, number_of_sources
from hilbench.estimation.bank import Array
from hilbench.estimation.web_line import ripples, swings

Places = NDArray[np.int64]

# State of a filter. The last two only where the rollers' radii differ: else they can't be told from the two before.
E, REST, SWAY, QUICK, OFFSET, DRY, STUCK, VISCOUS, SCALE, MASS, UNBALANCE_COS, UNBALANCE_SIN, CREEP = range(13)
COS2, SIN2, COS1, SIN1 = range(13, 17)
LARGEST, SIZE_OF_EQUALS = 17, 15
#: From here on: times E.
_OF_STRAIN = CREEP
#: Groups of which the model may lack all or none.
GROUPS = (
    (OFFSET,),
    (DRY, STUCK, VISCOUS),
    (SCALE, MASS),
    (CREEP,),
    (UNBALANCE_COS, UNBALANCE_SIN, COS2, SIN2, COS1, SIN1),
)

# Inputs of a cycle.
(
    CYCLE_S,
    BLOCK,  # cycles of a block
    FORCE_N,  # y + m·v', of this instant
    WEB_N,  # tension at the reference E
    TOLD,  # E that is told over the reference E
    SPEED_M_S,
    RESISTANCE_N,  # friction of the model
    NEXT_N,  # tension behind the roller
    ANGLE_1,
    ANGLE_2,
    MOTOR_ANGLE,
    MASS_KG,
    SPAN_M,
    STIFFNESS_N,  # E·S at the reference E
    VARIANCE_N2,  # of FORCE_N, white
    POSITION_M2,  # variance of an encoder's position
    REST_N,  # deviation of a force that comes and goes
    CURVE_N2,  # variance by which friction is another one after a change of speed by 1 m/s
    STANDSTILL_M_S,  # speed up to which a roller may stand
    STUCK_N,  # prior deviation of what keeps a roller at rest
    STEADY_E2,  # variance per s by which E may walk while speed and tension stay
    TOLD_JUMPED,  # E that is told is another one than before the last blocks
    MOST_SWAY_N,  # what a tension sways by, at the reference E, at most
) = range(23)
INPUTS = 23
# What is kept from cycle to cycle.
(
    COUNT,
    BEGAN_M_S,  # speed at the block's beginning
    BUILT_UP_N,  # q
    DIRECTED_M_S,  # smoothed speed, whose sign dry friction has
    SMOOTHED_M_S,
    ACCELERATION,
    STOOD,  # share of the last block in which the roller stood
    SPREAD_N,  # deviation of what is taken out of the force now
    CORRECTION_N,
    REBASED_N,  # by how much more is taken out of the force, swings apart, than with what was known a cycle before
    WOBBLE,  # cosine and sine of the rollers' angles, as a strain of the span: 4 places
    _,
    _,
    _,
    WEB_BEFORE_N,  # tension at the reference E in the last block
    USUAL_WEB_N,  # the same, smoothed
    EXCESS,  # square of the innovations over what it is expected to be
    SURPRISED,  # the last block did not fit
    LEANING,  # mean of the innovations over their deviations
    APPLIED,  # share of what is believed to be lacking that is taken out of the force
    LACKING,  # probability that the model lacks something
    JUMPED_S,  # time since E has jumped
    BEYOND_N,  # force beside the web's that the filter of all errors has found, swings apart
    RIPPLE_N,  # force of the motor's ripples that have been found
    RIPPLES_CHANGED,  # another has been found
    PRIOR_N2,  # variance of what may be taken for tension where nothing has been measured
    SLOW_WEB_N,  # mean of the tension at the reference E over some seconds of steady speed
    SLOW_BLOCKS,  # blocks since that mean has begun
    USUAL_M_S,  # speed, smoothed over longer
    SWINGS,  # the strain goes to and fro
    INTERCEPT_N,  # deviation of what would be taken out of the force of a web that pulls no more
) = range(31)
_SWING = 31  # what `swings` keeps
KEPT = _SWING + swings.SIZE
#: Smoothing of the speed that dry friction goes by, and of that which the error of the mass goes by, s.
_DIRECTION_S, _ACCELERATION_S = 0.02, 0.1
#: Memory of the force that comes and goes, s.
_REST_MEMORY_S = 1.0
#: Share of the inertial force that counts as noise where the speed shakes.
_SHAKING = 0.1
#: Change of tension from block to block that counts as noise, times this: torque and motion are of one instant to some
#: milliseconds only, and what shakes the roller moves the strain, too. So E is told from what is beside it by slow
#: changes of the tension alone.
_LATE, _QUICK = 0.15, 2.5
#: Share of the friction's prior that counts as noise while a roller neither stands nor rolls.
_PRESLIDING = 0.25
#: What is steady: acceleration (m/s²), difference of the tension from its mean over some time (s), relative.
_STEADY_M_S2, _STEADY_S, _STEADY_WEB = 0.03, 0.3, 0.01
#: A speed that is the same as its mean over some time (s), to so much (m/s).
_USUAL_SPEED_S, _SAME_SPEED_M_S = 0.5, 0.01
#: Time over which the mean of the tension is taken that it sways about; in which the share of the strain's sway that is
#: no tension becomes another one, s.
_SLOW_S, _SWAY_MEMORY_S = 5.0, 30.0
#: Deviation of that share.
SWAY_SHARE = 0.6
#: Memory of the share of what it sways by quickly, s, and the deviation of that.
_QUICK_MEMORY_S, QUICK_SHARE = 60.0, 1.0
#: How far the strain swings at least, as a share of the tension.
_LEAST_SWING = 3e-3
#: Share of the dry friction that is found which may be gone at speed (standard deviation), and the speed by which most
#: of that is: friction that is larger at the onset than later (Stribeck).
_ONSET_SHARE, _ONSET_M_S = 0.25, 0.5
#: Innovations beyond so many deviations are no noise; and a mean of them (over so many blocks) beyond so many.
_SURPRISE, _LEANS, _LEANING_BLOCKS = 4.0, 5.0, 25.0
#: By how much E may have changed then, relative.
_JUMP, _SMALL_JUMP = 0.3, 0.03
#: Memory of the innovations' size, s, and the most that one counts of it.
_EXCESS_S, _MOST_EXCESS = 2.0, 30.0
#: Evidence against a set of errors reaches no farther (logarithm): what comes later can still change it.
_LEAST_WEIGHT = -14.0
#: Probability of a lack from which on it is taken out of the force, and up to which no longer; how fast, 1/s.
#: And the size of the innovations beyond which none of the sets is believed.
_SURE, _UNSURE, _APPLIED_PER_S, _FITS_NONE = 0.99, 0.5, 2.0, 2.0


@compiled
def _predict(z: Array, p: Array, k: int, places: Places, process: Array, dt: float) -> None:
    """Filter `k` over a block of `dt`; process (N,): variances that it adds."""
    keep, keep_sway, keep_quick = 1.0 - dt / _REST_MEMORY_S, 1.0 - dt / _SWAY_MEMORY_S, 1.0 - dt / _QUICK_MEMORY_S
    z[k, REST] *= keep
    z[k, SWAY] *= keep_sway
    z[k, QUICK] *= keep_quick
    for m in range(places.shape[1]):
        i = places[k, m]
        if i < 0:
            break
        p[k, REST, i] *= keep
        p[k, i, REST] *= keep
        p[k, SWAY, i] *= keep_sway
        p[k, i, SWAY] *= keep_sway
        p[k, QUICK, i] *= keep_quick
        p[k, i, QUICK] *= keep_quick
        p[k, i, i] += process[i]


@compiled
def _innovation(z: Array, p: Array, k: int, places: Places, a: Array, y: float, row: Array) -> float:
    """Mean of a block y less what filter `k` expects; row (N,): covariance of that with the states; row[N]: its
    variance without the noise."""
    # What errors of the strain make of the tension goes with E: linearized at the E of this filter.
    modulus, strain_N, predicted = z[k, E], 0.0, 0.0
    size = z.shape[1]
    for m in range(places.shape[1]):
        i = places[k, m]
        if i < 0:
            break
        if i >= _OF_STRAIN:
            strain_N += a[i] * z[k, i]
        else:
            predicted += a[i] * z[k, i]
    predicted += modulus * strain_N
    spread = 0.0
    for m in range(places.shape[1]):
        i = places[k, m]
        if i < 0:
            break
        total = strain_N * p[k, i, E]
        for n in range(places.shape[1]):
            j = places[k, n]
            if j < 0:
                break
            total += p[k, i, j] * a[j] * (modulus if j >= _OF_STRAIN else 1.0)
        row[i] = total
        spread += a[i] * total * (modulus if i >= _OF_STRAIN else 1.0)
    row[size] = spread + strain_N * row[E]
    return float(y - predicted)


@compiled
def _less_quick(p: Array, k: int, a: Array, row: Array) -> float:
    """The variance in row (N + 1,) without what is not known of QUICK: that would explain a kick of any size."""
    return max(float(row[p.shape[1]] - 2.0 * a[QUICK] * row[QUICK] + a[QUICK] * a[QUICK] * p[k, QUICK, QUICK]), 0.0)


@compiled
def _take(z: Array, p: Array, k: int, places: Places, row: Array, innovation: float, spread: float) -> None:
    for m in range(places.shape[1]):
        i = places[k, m]
        if i < 0:
            break
        gain = row[i] / spread
        z[k, i] += gain * innovation
        for n in range(m + 1):
            j = places[k, n]
            p[k, i, j] -= gain * row[j]
            p[k, j, i] = p[k, i, j]


@compiled
def _regressors(u: Array, s: Array, a: Array, size: int, found: float) -> None:
    """What each of `size` states adds to the force at this instant, those of the strain at the reference E; a (N,).

    `found`: all force at the web that has been found, whatever is believed to be tension of it, without what comes and
    goes: regressors with something of the noise of y would explain it.
    """
    speed = u[SPEED_M_S]
    # Smoothed, like the acceleration: noise of the encoder is in the block's mean, and must not be in what explains it.
    direction = min(max(s[DIRECTED_M_S] / u[STANDSTILL_M_S], -1.0), 1.0)
    inertia = u[MASS_KG] * s[ACCELERATION]
    a[E] = u[WEB_N]
    a[REST] = 1.0
    a[SWAY] = 0.0
    if abs(s[USUAL_M_S]) > u[STANDSTILL_M_S]:  # at rest no web comes in
        a[SWAY] = min(max(s[USUAL_WEB_N] - s[SLOW_WEB_N], -u[MOST_SWAY_N]), u[MOST_SWAY_N])
    a[QUICK] = u[WEB_N] - s[USUAL_WEB_N] if s[SWINGS] != 0.0 else 0.0
    a[OFFSET] = 1.0
    a[DRY] = direction
    a[STUCK] = 1.0 - abs(direction)
    a[VISCOUS] = speed
    a[SCALE] = found + inertia + u[RESISTANCE_N] - u[NEXT_N]
    a[MASS] = inertia
    a[UNBALANCE_COS] = cos(u[ANGLE_2])
    a[UNBALANCE_SIN] = sin(u[ANGLE_2])
    a[CREEP] = -u[STIFFNESS_N] * s[BUILT_UP_N]
    for j in range(COS2, size):
        a[j] = u[STIFFNESS_N] * s[WOBBLE + j - COS2]


@compiled
def _transport(u: Array, s: Array, states: int, found: float) -> None:
    """What creep and eccentricity have made of the span's strain, per unit of either, after a cycle."""
    share = min(abs(u[SPEED_M_S]) * u[CYCLE_S] / u[SPAN_M], 1.0)
    s[BUILT_UP_N] += share * (found - u[NEXT_N] - s[BUILT_UP_N])
    s[WOBBLE] += share * (cos(u[ANGLE_2]) - s[WOBBLE])
    s[WOBBLE + 1] += share * (sin(u[ANGLE_2]) - s[WOBBLE + 1])
    if states > COS1:
        s[WOBBLE + 2] += share * (cos(u[ANGLE_1]) - s[WOBBLE + 2])
        s[WOBBLE + 3] += share * (sin(u[ANGLE_1]) - s[WOBBLE + 3])


@inlined
def keeps_speed(u: Array, s: Array) -> bool:
    """Whether the roller turns, and as fast as some tenths of a second before, whatever shakes it."""
    return bool(abs(s[SMOOTHED_M_S] - s[USUAL_M_S]) < _SAME_SPEED_M_S and abs(s[USUAL_M_S]) > u[STANDSTILL_M_S])


@inlined
def keeps_acceleration(s: Array) -> bool:
    """Whether the roller's speed changes as fast as some tenths of a second before, or keeps."""
    apart_s = _USUAL_SPEED_S - _ACCELERATION_S
    return bool(abs(apart_s * s[ACCELERATION] - (s[SMOOTHED_M_S] - s[USUAL_M_S])) < _SAME_SPEED_M_S)


@compiled
def _swings(i: int) -> bool:
    return i >= COS2 or UNBALANCE_COS <= i <= UNBALANCE_SIN


@compiled
def _of_terms(a: Array, theta: Array, told: float, swings: bool) -> float:
    """Force of the errors theta (N,); with or without what swings with a roller's angle."""
    total = 0.0
    for i in range(OFFSET, len(theta)):
        if swings or not _swings(i):
            total += a[i] * theta[i] * (told if i >= _OF_STRAIN else 1.0)
    return total


@compiled
def _stop(z: Array, p: Array, k: int, deviation: float) -> None:
    """What keeps a roller at rest is another force each time."""
    if p[k, STUCK, STUCK] == 0.0:
        return
    z[k, STUCK] = 0.0
    for j in range(z.shape[1]):
        p[k, STUCK, j] = 0.0
        p[k, j, STUCK] = 0.0
    p[k, STUCK, STUCK] = deviation * deviation


@compiled
def _leave_onset(z: Array, p: Array, speed: float, change: float) -> None:
    """Dry friction may be another one after a change of a low speed: the more there is of it, the more."""
    share = _ONSET_SHARE * _ONSET_SHARE * exp(-abs(speed) / _ONSET_M_S) * abs(change) / _ONSET_M_S
    for k in range(z.shape[0]):
        if p[k, DRY, DRY] > 0.0:
            p[k, DRY, DRY] += share * z[k, DRY] * z[k, DRY]


@compiled
def _free_modulus(p: Array, variance: float) -> None:
    """E of every filter may be another one."""
    for k in range(p.shape[0]):
        p[k, E, E] += variance


@compiled
def _weigh(s: Array, weights: Array) -> None:
    """The best weight is 0, and what the model with nothing lacking (the first) has of all of them."""
    best, total = -1e300, 0.0
    for k in range(len(weights)):
        best = max(best, weights[k])
    for k in range(len(weights)):
        weights[k] = max(weights[k] - best, _LEAST_WEIGHT)
        total += exp(weights[k])
    s[LACKING] = 1.0 - exp(weights[0]) / total


@compiled
def _believe(s: Array, z: Array, weights: Array, theta: Array, dt: float) -> None:
    """theta (N,): what is taken out of the force."""
    if s[EXCESS] > _FITS_NONE:
        goal = 0.0
    elif s[LACKING] > _SURE:
        goal = 1.0
    elif s[LACKING] < _UNSURE:
        goal = 0.0
    else:
        goal = 1.0 if s[APPLIED] > 0.5 else 0.0
    step = _APPLIED_PER_S * dt
    s[APPLIED] += min(max(goal - s[APPLIED], -step), step)
    total = 0.0
    for k in range(len(weights)):
        total += exp(weights[k])
    for j in range(OFFSET, len(theta)):
        theta[j] = 0.0
        if s[APPLIED] > 0.0:
            for k in range(len(weights)):
                theta[j] += s[APPLIED] * exp(weights[k]) / total * z[k, j]


@compiled
def _spread_N(z: Array, p: Array, a: Array, theta: Array, told: float, lacking: float) -> float:
    """Deviation of the force that theta (N,) makes, by the filter of all errors: what that can't tell apart, and, as
    far as something is `lacking`, how far what is told is from what it believes."""
    all_of_them, size = z.shape[0] - 1, z.shape[1]
    variance, apart = 0.0, 0.0
    for i in range(REST, size):
        b = a[i] * (told if i >= _OF_STRAIN else 1.0)
        apart += b * (z[all_of_them, i] - theta[i])
        for j in range(REST, size):
            variance += b * a[j] * (told if j >= _OF_STRAIN else 1.0) * p[all_of_them, i, j]
    return sqrt(max(variance, 0.0) + lacking * apart * apart)


@compiled
def _of_no_tension(u: Array, s: Array, a: Array, found: float, b: Array) -> None:
    """What each error adds to the force of a web that pulls no more, as regressors b (N,) like a (N,); what comes and
    goes, sways and swings: nothing."""
    for i in range(len(b)):
        b[i] = 0.0 if i < OFFSET or _swings(i) else a[i]
    b[SCALE] -= found
    b[CREEP] = u[STIFFNESS_N] * (found - s[BUILT_UP_N])


@compiled
def _believed_of_nothing_N2(a: Array, priors: Array, told: float) -> float:
    """Variance of the force where nothing has been measured."""
    variance = 0.0
    for i in range(OFFSET, len(priors)):
        force = a[i] * priors[i] * (told if i >= _OF_STRAIN else 1.0)
        variance += force * force
    return variance


@compiled
def _block(
    u: Array,
    s: Array,
    z: Array,
    p: Array,
    places: Places,
    weights: Array,
    process: Array,
    mean: Array,
    y: float,
    variance: float,
    quick: float,
    dt: float,
    row: Array,
) -> None:
    """A block's means into all filters; `quick`: variance beside `variance` by which less is learned from it, but which
    is no reason not to be surprised."""
    size, all_of_them = z.shape[1], z.shape[0] - 1
    for k in range(z.shape[0]):
        _predict(z, p, k, places, process, dt)
    innovation = _innovation(z, p, all_of_them, places, mean, y, row)
    size_of_it = innovation / sqrt(_less_quick(p, all_of_them, mean, row) + variance)
    s[JUMPED_S] += dt
    s[EXCESS] += dt / _EXCESS_S * (min(size_of_it * size_of_it, _MOST_EXCESS) - s[EXCESS])
    if abs(size_of_it) > _SURPRISE:
        if s[SURPRISED] == 0.0:
            s[SURPRISED] = 1.0
            return
        _free_modulus(p, _JUMP * _JUMP)
        s[SLOW_BLOCKS] = 0.0
        s[LEANING] = 0.0
        s[JUMPED_S] = 0.0
    else:
        s[LEANING] += (size_of_it - s[LEANING]) / _LEANING_BLOCKS
        if abs(s[LEANING]) > _LEANS / sqrt(2.0 * _LEANING_BLOCKS):
            _free_modulus(p, _SMALL_JUMP * _SMALL_JUMP)
            s[LEANING] = 0.0
    s[SURPRISED] = 0.0
    if u[TOLD_JUMPED] != 0.0:
        _free_modulus(p, _JUMP * _JUMP)
        s[LEANING] = s[JUMPED_S] = 0.0
    for k in range(z.shape[0]):
        innovation = _innovation(z, p, k, places, mean, y, row)
        spread = float(row[size] + variance + quick)
        weights[k] -= 0.5 * (innovation * innovation / spread + log(2.0 * pi * spread))
        _take(z, p, k, places, row, innovation, spread)
    _weigh(s, weights)


def _compiled_cycle(sources: int) -> Callable[..., bool]:
    """The function that is called from Python; `sources` as in `number_of_sources`."""

    @entry_point(VECTOR, VECTOR, MATRIX, CUBE, TABLE, VECTOR, VECTOR, MATRIX, VECTOR, VECTOR, MATRIX, VECTOR)
    def cycle(
        u: Array,
        s: Array,
        z: Array,
        p: Array,
        places: Places,
        weights: Array,
        process_per_s: Array,
        work: Array,
        theta: Array,
        priors: Array,
        orders: Array,
        kept_of_orders: Array,
    ) -> bool:
        """One cycle; True when a block has ended with it.

        u (INPUTS,), s (KEPT,); of the filters: z (K, N), p (K, N, N), places (K, N) of what each estimates, -1 behind
        the last, weights (K,), process_per_s (N,); work (3, N + 1): regressors of now, their sums, scratch; theta (N,):
        what is taken out of the force, priors (N,): deviations of what may be lacking; orders and kept_of_orders as
        in `ripples`.
        """
        if sources < 0:
            return False
        a, sums, row = work[0], work[1], work[2]
        dt, n, size = u[CYCLE_S], u[BLOCK], z.shape[1]
        speed = u[SPEED_M_S]
        slope = (speed - s[SMOOTHED_M_S]) / (_ACCELERATION_S + dt)
        s[SMOOTHED_M_S] += slope * dt
        s[USUAL_M_S] += (speed - s[USUAL_M_S]) * dt / _USUAL_SPEED_S
        s[DIRECTED_M_S] += (speed - s[DIRECTED_M_S]) * dt / (_DIRECTION_S + dt)
        s[ACCELERATION] = slope
        ended = s[COUNT] >= n
        s[REBASED_N] = 0.0
        if ended:
            acceleration = (speed - s[BEGAN_M_S]) / (n * dt)
            for j in range(size + 1):
                sums[j] /= n
            y = sums[size] - u[MASS_KG] * acceleration
            at_rest = sums[STUCK]
            shaking = _SHAKING * u[MASS_KG] * (slope - acceleration)
            presliding = _PRESLIDING * u[STUCK_N] * (1.0 - abs(2.0 * at_rest - 1.0))
            variance = (
                u[VARIANCE_N2] / n
                + 4.0 * u[POSITION_M2] * (u[MASS_KG] / (n * dt * dt)) ** 2
                + shaking * shaking
                + presliding * presliding
                + (_LATE * (sums[E] - s[WEB_BEFORE_N])) ** 2
            ) * max(s[EXCESS], 1.0)
            quick = (_QUICK * (sums[E] - s[WEB_BEFORE_N])) ** 2
            s[WEB_BEFORE_N] = sums[E]
            steady = abs(slope) < _STEADY_M_S2 and abs(sums[E] - s[USUAL_WEB_N]) < _STEADY_WEB * abs(sums[E])
            s[USUAL_WEB_N] += n * dt / _STEADY_S * (sums[E] - s[USUAL_WEB_N])
            swung_N, least_N = sums[E] - s[USUAL_WEB_N], _LEAST_SWING * abs(s[USUAL_WEB_N])
            s[SWINGS] = 1.0 if swings.look(s, _SWING, swung_N, least_N, u[ANGLE_2], n * dt) else 0.0
            if not keeps_speed(u, s) or u[TOLD_JUMPED] != 0.0:
                s[SLOW_BLOCKS] = 0.0
            s[SLOW_BLOCKS] += 1.0
            s[SLOW_WEB_N] += max(n * dt / _SLOW_S, 1.0 / s[SLOW_BLOCKS]) * (sums[E] - s[SLOW_WEB_N])
            if at_rest > 0.5 and s[STOOD] <= 0.5:
                for k in range(z.shape[0]):
                    _stop(z, p, k, u[STUCK_N])
            s[STOOD] = at_rest
            process = row
            for j in range(size):
                process[j] = process_per_s[j] * n * dt
            if steady:
                process[E] = u[STEADY_E2] * n * dt
            process[REST] = 2.0 * n * dt / _REST_MEMORY_S * u[REST_N] * u[REST_N]
            process[QUICK] = 2.0 * n * dt / _QUICK_MEMORY_S * QUICK_SHARE**2
            process[SWAY] = 2.0 * n * dt / _SWAY_MEMORY_S * SWAY_SHARE**2
            if process[DRY] > 0.0:
                process[DRY] += u[CURVE_N2] * abs(speed - s[BEGAN_M_S])
                _leave_onset(z, p, speed, speed - s[BEGAN_M_S])
            _block(u, s, z, p, places, weights, process, sums, y, variance, quick, n * dt, work[3])
            s[COUNT] = 0.0
        modulus = z[z.shape[0] - 1, E]
        if ended:
            s[BEYOND_N] = _of_terms(a, z[z.shape[0] - 1], modulus, False)
        found = u[WEB_N] * modulus + s[BEYOND_N]
        _regressors(u, s, a, size, found)
        if s[COUNT] == 0.0:
            s[BEGAN_M_S] = speed
            for j in range(size + 1):
                sums[j] = 0.0
        for j in range(size):
            sums[j] += a[j]
        # By the filter that lacks nothing: one in which E has a slope explains a ripple by the strain that it moves.
        expected = u[WEB_N] * z[0, E] + z[0, REST]
        changed = ripples.look(orders, kept_of_orders, u[FORCE_N], expected, speed, u[MOTOR_ANGLE], u[MASS_KG], dt)
        s[RIPPLES_CHANGED] = 1.0 if changed else 0.0
        s[RIPPLE_N] = ripples.ripple_N(orders, u[MOTOR_ANGLE])
        sums[size] += u[FORCE_N] - s[RIPPLE_N]
        s[COUNT] += 1.0
        _transport(u, s, size, found)
        if ended:
            before = _of_terms(a, theta, u[TOLD], False)
            _believe(s, z, weights, theta, n * dt)
            s[REBASED_N] = _of_terms(a, theta, u[TOLD], False) - before
            s[SPREAD_N] = _spread_N(z, p, a, theta, u[TOLD], s[LACKING])
            _of_no_tension(u, s, a, found, row)
            s[INTERCEPT_N] = _spread_N(z, p, row, theta, u[TOLD], 1.0)
            s[PRIOR_N2] = _believed_of_nothing_N2(a, priors, u[TOLD])
        s[CORRECTION_N] = _of_terms(a, theta, u[TOLD], True) + s[RIPPLE_N]
        return bool(ended)

    return cycle


cycle = _compiled_cycle(number_of_sources(ripples.__file__, swings.__file__, __file__))
