"""Bounds of a span's tension by physics: an interval from torques, encoders and the model's possible errors.

They use nothing of a twin's estimator. The momentum balances of the driven rollers j after span k add up to

    F_k = Σ_j [(i/r)_j·τ_j − R_j(v_j) − m_j·v_j'] + F_next

taken over blocks of 0.1 s. A twin's tension has to be in three intervals, each of means over 1 s:

- Tension: F_k ± 3·σ, σ² = Σ_j [dry² + (viscous·v)² + offset² + (scale·F_motor)² + (inertia·v')²] + turning², by the
  standard deviations of `ModelErrorsConfig`, and dry friction of the model where a roller may stick. Any two errors of
  two deviations each and one sign are inside: 2·(a + b) ≤ 2·√2·√(a² + b²) < 3·√(a² + b²).
- Modulus: F_k ± 3·σ over S·ε, with ε by mass conservation from the encoders, and what strain may lack.
- Change: at constant speed and set-point only E·ε changes quickly, so F_twin − F_k stays as it was, within
  2.5 % of the set-point (E is to be right within 1 %), twice the ripple that turns with the rollers, its own swings
  before (tension upstream that no encoder shows), and friction that warms up.

A violation shorter than `PERSISTS_S` is not reported: so long a twin may search for an E that has stepped.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import compiled
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

#: Blocks in a mean; the newer and the older half of them have to agree that something is beyond.
BLOCKS, _HALF = 10, 5
#: Standard deviations of the intervals of tension and modulus: see above. A stand in 370 is outside although all of
#: its errors are within their priors, if it was never commissioned.
DEVIATIONS = 3.0
#: Share of the set-point, and deviations of the turning ripple, by which the twin may differ from the torques.
_CHANGE_SHARE, _TURNING_DEVIATIONS = 0.025, 2.0
#: Time in which friction that warms up changes by a standard deviation at the fastest, as bearings and seals take
#: minutes; a difference that goes with twice that is followed.
_WARMS_UP_S, _WARMING_DEVIATIONS = 180.0, 2.0
#: Constant speed and set-point before a difference counts as what it is at rest of changes: what was learned in a ramp
#: is believed 1 s behind it, and a mean is of 1 s. After a step of E a twin may still find that it was friction.
_SETTLED_S, _AFTER_STEP_S = 2.0, 5.0
#: A difference is a mean over two of these intervals, and swings by what it has in both of them: a period of 8 s and
#: shorter. Until then it may be twice as far off.
_INTERVAL_S, _LEARNING_BLOCKS = 8.0, 160.0
#: Relative change of E that is passed to an open loop.
_WORTH_TELLING = 0.01
#: Change of E by torques, and share of it that the twin has to have followed, that is a step of E.
_STEP_SHARE, _FOLLOWED = 0.05, 0.5
#: Duration of a violation before it is reported, longer than the slowest method needs for a step of E (0.75 s).
PERSISTS_S = 0.8
#: The twin is trusted again when it has been within this share of the interval for this time.
_RETURN_SHARE, _RETURN_S = 0.8, 5.0
#: Share of the usual strain below which E is not identifiable.
_LEAST_STRAIN = 0.25
#: Below this speed at the web a roller may stick.
STICKS_M_S = 2e-3

#: Of a driven roller: what forces are made of (rad/m, kg, radius in m), then deviations of what the model may lack as
#: forces at the web: dry, viscous per m/s, offset, share of the motor's, kg that are accelerated, unbalance.
(RAD_PER_M, MASS_KG, RADIUS_M, DRY_N, VISCOUS, OFFSET_N, SCALE, INERTIA_KG, UNBALANCE_N, ROLLER) = range(10)
#: Means of a roller over a block: torque, speed, acceleration.
TORQUE_NM, SPEED_M_S, RATE_M_S2, MOTION = range(4)
#: A block of a span: tension by torques, its variance, dry friction that may hold a roller, turning ripple (deviation);
#: tension and E by the twin; section times strain (0: unknown); speed; duration; 1 if the loop was closed on
#: the twin; 1 if nothing was changed.
(TENSION_N, VARIANCE_N2, STICKS_N, TURNING_N, TWIN_N, TWIN_PA, STRETCH_M2) = range(7)
(LINE_M_S, BLOCK_S, CLOSED, UNCHANGED, BLOCK) = range(7, 12)
#: Of a span: usual tension and usual section times strain; deviations of the strain, relative, and of what creep takes
#: per relative difference of tensions; tension behind the line; dry friction, and viscous per m/s, of all rollers
#: behind the span; whether changes are judged; swing of the tension by eccentric rollers at its ends; mass, dry and
#: viscous friction of the idlers behind it; section.
USUAL_N, USUAL_M2, STRAIN_SHARE, CREEP_SHARE, NEXT_N, WARMS_N, OF_SPEED, CHANGES, ECCENTRIC_N = range(9)
IDLERS_KG, IDLERS_DRY_N, IDLERS_VISCOUS, SECTION_M2, SPAN = range(9, 14)
#: State of a span: blocks in the ring and the place of the next; time since all is constant; 1 if the
#: difference then is known, its value, and at which speed; how long the twin has been beyond, and back; the verdict
#: reported; then the mean tension of the twin, its interval, E of the twin and its interval, E by torques and encoders,
#: and the E passed to an open loop; of the difference: blocks in it, its least and most in this interval,
#: the interval's length, and half of its range in the two before (below 0: unknown).
FILLED, NEXT, CONSTANT_S, KNOWN, DIFFERENCE_N, KNOWN_AT_M_S, BEYOND_S, BACK_S, REPORTED = range(9)
(MEAN_N, LOW_N, HIGH_N, MEAN_PA, LOW_PA, HIGH_PA, BY_TORQUES_PA, ASSUMED_PA) = range(9, 17)
(LEARNED, LEAST_N, MOST_N, INTERVAL_S, SWINGS_N, SWUNG_N, STATE) = range(17, 24)
#: Verdicts on a twin.
NOTHING, TENSION, MODULUS, CHANGE = 0.0, 1.0, 2.0, 3.0


@compiled
def stretch(
    unstretched_m: Vector, strains: Vector, lengths_m: Vector, travels_m: Vector, before: float, behind: float
) -> None:
    """Mass conservation: update web in the spans (K,), unstretched, and its strains after a displacement of the rollers
    by `travels_m` (K + 1,); `before`, `behind`: strains of the web around the line. Web passes a roller with the
    strain of the side it comes from."""
    count = len(lengths_m)
    came_m = travels_m[0] / (1.0 + (before if travels_m[0] >= 0.0 else strains[0]))
    for k in range(count):
        strain = strains[k]
        if travels_m[k + 1] < 0.0:
            strain = strains[k + 1] if k + 1 < count else behind
        went_m = travels_m[k + 1] / (1.0 + strain)
        unstretched_m[k] += came_m - went_m
        came_m = went_m
    for k in range(count):
        strains[k] = lengths_m[k] / unstretched_m[k] - 1.0


@compiled
def driving_N(p: Vector, axis: int, torque_Nm: float, v_m_s: float) -> float:
    """Force at the web of a motor less its roller's resistance, by the parameters of a line; `axis` from 0."""
    of_axis = lay.W_SIZE + axis * lay.A_SIZE
    motor = lay.W_SIZE + int(p[lay.W_AXES]) * lay.A_SIZE + axis * lay.M_SIZE
    direction = measured_direction(v_m_s, laws.FRICTION_WIDTH_M_S)
    shaft_Nm = laws.shaft_torque_Nm(p, motor, laws.true_torque_Nm(p, motor, torque_Nm), 0.0)
    passed_N = laws.passed_on_N(p, of_axis, p[motor + lay.M_RAD_PER_M] * shaft_Nm, direction)
    return float(passed_N - laws.measured_resistance_N(p, of_axis, 0.0, v_m_s, direction))


@compiled
def sticking_N(p: Vector, axis: int) -> float:
    """Dry friction of the model by which a roller at rest may hold either way, N."""
    return float(laws.breakaway_N(p, lay.W_SIZE + axis * lay.A_SIZE))


@compiled
def _kept_of_a_turn(radius_m: float, travel_m: float) -> float:
    """Largest share of the amplitude of a once-per-turn ripple that a mean over this travel keeps."""
    return min(1.0, 2.0 * radius_m / travel_m) if travel_m > 0.0 else 1.0


@compiled
def momentum_balance(
    p: Vector, f: Vector, rollers: Matrix, motion: Matrix, first: int, mean_s: float, block: Vector
) -> None:
    """Momentum balance: tension before the roller of index `first`, and its error, into a block: `rollers` (N, ROLLER),
    their `motion` (N, MOTION); block[TENSION_N]: tension after the line at first; `mean_s`: averaging time."""
    block[VARIANCE_N2], block[STICKS_N], turning_N2 = 0.0, 0.0, 0.0
    for j in range(first, len(rollers)):
        roller, torque_Nm = rollers[j], motion[j, TORQUE_NM]
        speed_m_s, rate_m_s2 = motion[j, SPEED_M_S], motion[j, RATE_M_S2]
        block[TENSION_N] += driving_N(p, j, torque_Nm, speed_m_s) - roller[MASS_KG] * rate_m_s2
        block[VARIANCE_N2] += roller[DRY_N] ** 2 + (roller[VISCOUS] * speed_m_s) ** 2 + roller[OFFSET_N] ** 2
        block[VARIANCE_N2] += (roller[SCALE] * roller[RAD_PER_M] * torque_Nm) ** 2
        block[VARIANCE_N2] += (roller[INERTIA_KG] * rate_m_s2) ** 2
        kept = _kept_of_a_turn(roller[RADIUS_M], abs(speed_m_s) * mean_s)
        turning_N2 += (roller[UNBALANCE_N] * kept) ** 2
        if j == first:
            turning_N2 += (f[ECCENTRIC_N] * kept) ** 2
        if abs(speed_m_s) < STICKS_M_S:
            block[STICKS_N] += sticking_N(p, j)
    last = len(rollers) - 1
    speed_m_s = motion[last, SPEED_M_S]
    dragged_N = f[IDLERS_VISCOUS] * speed_m_s
    dragged_N += f[IDLERS_DRY_N] * measured_direction(speed_m_s, laws.FRICTION_WIDTH_M_S)
    block[TENSION_N] -= dragged_N + f[IDLERS_KG] * motion[last, RATE_M_S2]
    block[VARIANCE_N2] += f[IDLERS_DRY_N] ** 2 + (f[IDLERS_VISCOUS] * speed_m_s) ** 2
    block[TURNING_N] = turning_N2**0.5


@compiled
def _mean(ring: Matrix, row: int, newest: int, first: int, count: int) -> float:
    """Mean of a row of the ring over `count` blocks, of which the newest is `first` blocks old."""
    total = 0.0
    for k in range(count):
        total += ring[row, (newest - first - k) % BLOCKS]
    return total / count


@compiled
def _lasts_beyond(ring: Matrix, newest: int, around_N: float, bound_N: float) -> bool:
    """True if the twin is beyond the bound in the mean, and both halves agree; also for a value that is no number."""
    newer_N = _mean(ring, TWIN_N, newest, 0, _HALF) - _mean(ring, TENSION_N, newest, 0, _HALF) - around_N
    older_N = _mean(ring, TWIN_N, newest, _HALF, _HALF) - _mean(ring, TENSION_N, newest, _HALF, _HALF) - around_N
    if abs(newer_N) < 0.5 * bound_N or abs(older_N) < 0.5 * bound_N or newer_N * older_N < 0.0:
        return False
    return not 0.5 * abs(newer_N + older_N) <= bound_N


@compiled
def _has_stepped(ring: Matrix, newest: int) -> bool:
    """True if E by torques and encoders has changed within the ring, and the twin's has followed."""
    stretch_m2 = _mean(ring, STRETCH_M2, newest, 0, _HALF), _mean(ring, STRETCH_M2, newest, _HALF, _HALF)
    if not (stretch_m2[0] > 0.0 and stretch_m2[1] > 0.0):
        return False
    newer_Pa = _mean(ring, TENSION_N, newest, 0, _HALF) / stretch_m2[0]
    older_Pa = _mean(ring, TENSION_N, newest, _HALF, _HALF) / stretch_m2[1]
    if not older_Pa > 0.0:
        return False
    by_torques = newer_Pa / older_Pa - 1.0
    by_twin = _mean(ring, TWIN_PA, newest, 0, _HALF) / _mean(ring, TWIN_PA, newest, _HALF, _HALF) - 1.0
    return abs(by_torques) > _STEP_SHARE and by_twin * by_torques > _FOLLOWED * by_torques**2


@compiled
def _learn(f: Vector, s: Vector, ring: Matrix, block: Vector, newest: int) -> None:
    """Learn the difference of the twin's tension from that of the torques while nothing changes."""
    if block[UNCHANGED] == 0.0 or block[CLOSED] == 0.0 or f[CHANGES] == 0.0:
        s[CONSTANT_S], s[KNOWN] = 0.0, 0.0
        return
    s[CONSTANT_S] += block[BLOCK_S]
    if _has_stepped(ring, newest):
        s[CONSTANT_S], s[KNOWN] = _SETTLED_S - _AFTER_STEP_S, 0.0
    difference_N = _mean(ring, TWIN_N, newest, 0, BLOCKS) - _mean(ring, TENSION_N, newest, 0, BLOCKS)
    if not np.isfinite(difference_N):
        return
    if s[KNOWN] == 0.0 and s[CONSTANT_S] >= _SETTLED_S and s[FILLED] >= BLOCKS:
        s[KNOWN], s[DIFFERENCE_N], s[KNOWN_AT_M_S] = 1.0, difference_N, block[LINE_M_S]
        s[LEARNED], s[INTERVAL_S], s[LEAST_N], s[MOST_N] = 1.0, 0.0, difference_N, difference_N
        s[SWINGS_N], s[SWUNG_N] = -1.0, -1.0
    elif s[KNOWN] != 0.0 and s[BEYOND_S] == 0.0:
        _refine(f, s, block, difference_N)


@compiled
def _refine(f: Vector, s: Vector, block: Vector, difference_N: float) -> None:
    """The known difference, by one more block."""
    off_N = difference_N - s[DIFFERENCE_N]
    most_N = _WARMING_DEVIATIONS * f[WARMS_N] * block[BLOCK_S] / _WARMS_UP_S
    s[LEARNED] += 1.0
    if s[LEARNED] < _LEARNING_BLOCKS:
        most_N = max(most_N, abs(off_N) / s[LEARNED])
    s[DIFFERENCE_N] += min(max(off_N, -most_N), most_N)
    s[LEAST_N], s[MOST_N] = min(s[LEAST_N], difference_N), max(s[MOST_N], difference_N)
    s[INTERVAL_S] += block[BLOCK_S]
    if s[INTERVAL_S] >= _INTERVAL_S:
        s[SWUNG_N], s[SWINGS_N] = s[SWINGS_N], 0.5 * (s[MOST_N] - s[LEAST_N])
        s[INTERVAL_S], s[LEAST_N], s[MOST_N] = 0.0, difference_N, difference_N


@compiled
def judge(f: Vector, s: Vector, ring: Matrix, block: Vector) -> bool:
    """Take a block. True if the verdict on the twin changes, or the E of an open loop (ASSUMED_PA).
    `f` (SPAN,), `s` (STATE,), `ring`
    (BLOCK, BLOCKS)."""
    newest = int(s[NEXT])
    if block[CLOSED] == 0.0 and s[REPORTED] == NOTHING:  # another reason holds the loop open: the twin is not used
        s[FILLED], s[CONSTANT_S], s[KNOWN], s[BEYOND_S] = 0.0, 0.0, 0.0, 0.0
        return False
    for row in range(BLOCK):
        ring[row, newest] = block[row]
    s[NEXT], s[FILLED] = (newest + 1) % BLOCKS, min(s[FILLED] + 1.0, BLOCKS)
    if s[FILLED] < BLOCKS:
        return False
    if s[REPORTED] == NOTHING:
        _learn(f, s, ring, block, newest)
    found = _find(f, s, ring, newest)
    if s[REPORTED] == NOTHING:
        s[BEYOND_S] = s[BEYOND_S] + block[BLOCK_S] if found != NOTHING else 0.0
        if s[BEYOND_S] < PERSISTS_S:
            return False
        s[REPORTED], s[BACK_S], s[ASSUMED_PA] = found, 0.0, s[BY_TORQUES_PA]
        return True
    comparable = _is_comparable(s, block)
    s[BACK_S] = s[BACK_S] + block[BLOCK_S] if found == NOTHING and comparable else 0.0
    if s[BACK_S] >= _RETURN_S:
        forget(s)
        return True
    if not (comparable and block[UNCHANGED] != 0.0 and s[BY_TORQUES_PA] > 0.0):
        return False
    if abs(s[BY_TORQUES_PA] / s[ASSUMED_PA] - 1.0) <= _WORTH_TELLING:
        return False
    s[ASSUMED_PA] = s[BY_TORQUES_PA]
    return True


@compiled
def _is_comparable(s: Vector, block: Vector) -> bool:
    """True if the known difference applies at this speed: not where a roller may stick, or has turned
    back."""
    known_m_s, now_m_s = s[KNOWN_AT_M_S], block[LINE_M_S]
    if abs(known_m_s) < STICKS_M_S or abs(now_m_s) < STICKS_M_S:
        return bool(s[KNOWN] == 0.0 or max(abs(known_m_s), abs(now_m_s)) < STICKS_M_S)
    return bool(s[KNOWN] == 0.0 or known_m_s * now_m_s > 0.0)


@compiled
def _find(f: Vector, s: Vector, ring: Matrix, newest: int) -> float:
    """Verdict: which quantity of the twin is beyond its interval; both are left in the state."""
    share = 1.0 if s[REPORTED] == NOTHING else _RETURN_SHARE
    tension_N = _mean(ring, TENSION_N, newest, 0, BLOCKS)
    turning_N = _mean(ring, TURNING_N, newest, 0, BLOCKS)
    lacks_N = DEVIATIONS * (_mean(ring, VARIANCE_N2, newest, 0, BLOCKS) + turning_N**2) ** 0.5
    lacks_N += _mean(ring, STICKS_N, newest, 0, BLOCKS)
    s[MEAN_N], s[MEAN_PA] = _mean(ring, TWIN_N, newest, 0, BLOCKS), _mean(ring, TWIN_PA, newest, 0, BLOCKS)
    around_N = s[DIFFERENCE_N] if s[KNOWN] != 0.0 else 0.0
    stretch_m2 = _mean(ring, STRETCH_M2, newest, 0, BLOCKS)
    s[BY_TORQUES_PA] = s[MEAN_PA] * (tension_N + around_N) / s[MEAN_N] if s[MEAN_N] > 0.0 else 0.0
    if stretch_m2 > _LEAST_STRAIN * f[USUAL_M2] > 0.0:
        s[BY_TORQUES_PA] = (tension_N + around_N) / stretch_m2
    if s[KNOWN] != 0.0:
        faster_m_s = abs(abs(ring[LINE_M_S, newest]) - abs(s[KNOWN_AT_M_S]))
        bound_N = _CHANGE_SHARE * f[USUAL_N] + _TURNING_DEVIATIONS * turning_N
        bound_N += min(s[SWINGS_N], s[SWUNG_N]) if min(s[SWINGS_N], s[SWUNG_N]) >= 0.0 else bound_N
        bound_N += f[OF_SPEED] * faster_m_s
        s[LOW_N], s[HIGH_N] = tension_N + around_N - bound_N, tension_N + around_N + bound_N
        if _lasts_beyond(ring, newest, around_N, share * bound_N):
            return CHANGE
    if s[REPORTED] != CHANGE:
        s[LOW_N], s[HIGH_N] = tension_N - lacks_N, tension_N + lacks_N
    if _lasts_beyond(ring, newest, 0.0, share * lacks_N):
        s[LOW_N], s[HIGH_N] = tension_N - lacks_N, tension_N + lacks_N
        return TENSION
    if not stretch_m2 > _LEAST_STRAIN * f[USUAL_M2] > 0.0:
        return NOTHING
    creep = f[CREEP_SHARE] * (tension_N - f[NEXT_N]) / f[USUAL_N]
    strained = share * DEVIATIONS * (f[STRAIN_SHARE] ** 2 + creep**2) ** 0.5
    s[LOW_PA] = (tension_N - share * lacks_N) / (stretch_m2 * (1.0 + strained))
    s[HIGH_PA] = (tension_N + share * lacks_N) / (stretch_m2 * max(1.0 - strained, 1e-3))
    return NOTHING if s[LOW_PA] <= s[MEAN_PA] <= s[HIGH_PA] else MODULUS


@compiled
def forget(s: Vector) -> None:
    """Reset for a new twin: no verdict, nothing known."""
    s[:] = 0.0


@compiled
def change_conditions(s: Vector) -> None:
    """Note a change of the machine, announced or found by the twin: a difference is to be learned anew."""
    s[CONSTANT_S] = 0.0
    if s[REPORTED] == NOTHING:
        s[KNOWN] = 0.0
