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

from hilbench.arrays import Vector
from hilbench.compiled import Record, Records, compiled, record_type
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.web_line import laws, records

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

#: Of a driven roller: what forces are made of (radius in m), then deviations of what the model may lack as forces at
#: the web: dry, viscous (per m/s), offset, share of the motor's, mass that is accelerated, unbalance.
ROLLER = record_type(
    *("rad_per_m", "mass_kg", "radius_m", "dry_N", "viscous", "offset_N", "scale", "inertia_kg", "unbalance_N")
)
#: Means of a roller over a block.
MOTION = record_type("torque_Nm", "speed_m_s", "rate_m_s2")
#: A block of a span: tension by torques, its variance, dry friction that may hold a roller, turning ripple (deviation);
#: tension and E by the twin; section times strain (0: unknown); speed; duration; 1 if the loop was closed on
#: the twin; 1 if nothing was changed.
BLOCK = record_type(
    *("tension_N", "variance_N2", "sticks_N", "turning_N", "twin_N", "twin_Pa", "stretch_m2"),
    *("line_m_s", "block_s", "closed", "unchanged"),
)
#: Of a span: usual tension and usual section times strain; deviations of the strain, relative, and of what creep takes
#: per relative difference of tensions; tension behind the line; dry friction, and viscous per m/s, of all rollers
#: behind the span; whether changes are judged; swing of the tension by eccentric rollers at its ends; mass, dry and
#: viscous friction of the idlers behind it; section.
SPAN = record_type(
    *("usual_N", "usual_m2", "strain_share", "creep_share", "next_N", "warms_N", "of_speed", "changes", "eccentric_N"),
    *("idlers_kg", "idlers_dry_N", "idlers_viscous", "section_m2"),
)
#: State of a span: blocks in the ring and the place of the next; time since all is constant; 1 if the
#: difference then is known, its value, and at which speed; how long the twin has been beyond, and back; the verdict
#: reported; then the mean tension of the twin, its interval, E of the twin and its interval, E by torques and encoders,
#: and the E passed to an open loop; of the difference: blocks in it, its least and most in this interval,
#: the interval's length, and half of its range in the two before (below 0: unknown).
STATE = record_type(
    *("filled", "next", "constant_s", "known", "difference_N", "known_at_m_s", "beyond_s", "back_s", "reported"),
    *("mean_N", "low_N", "high_N", "mean_Pa", "low_Pa", "high_Pa", "by_torques_Pa", "assumed_Pa"),
    *("learned", "least_N", "most_N", "interval_s", "swings_N", "swung_N"),
)
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
def momentum_balance(
    p: Vector, f: Record, rollers: Records, motion: Records, first: int, mean_s: float, block: Record
) -> None:
    """Momentum balance: tension before the roller of index `first`, and its error, into a block: `rollers` (N, ROLLER),
    their `motion` (N, MOTION); block.tension_N: tension after the line at first; `mean_s`: averaging time."""
    block.variance_N2, block.sticks_N, turning_N2 = 0.0, 0.0, 0.0
    line = records.of_parameters(p)
    for j in range(first, len(rollers)):
        roller, axis, torque_Nm = rollers[j], records.axis(line, j), motion[j].torque_Nm
        speed_m_s, rate_m_s2 = motion[j].speed_m_s, motion[j].rate_m_s2
        driving_N = laws.measured_drive_N(axis, records.motor(line, j), torque_Nm, 0.0, speed_m_s)
        block.tension_N += driving_N - roller.mass_kg * rate_m_s2
        block.variance_N2 += roller.dry_N**2 + (roller.viscous * speed_m_s) ** 2 + roller.offset_N**2
        block.variance_N2 += (roller.scale * roller.rad_per_m * torque_Nm) ** 2
        block.variance_N2 += (roller.inertia_kg * rate_m_s2) ** 2
        travel_m = abs(speed_m_s) * mean_s  # a mean over it keeps at most this share of a ripple once a turn
        kept = min(1.0, 2.0 * roller.radius_m / travel_m) if travel_m > 0.0 else 1.0
        turning_N2 += (roller.unbalance_N * kept) ** 2
        if j == first:
            turning_N2 += (f.eccentric_N * kept) ** 2
        if abs(speed_m_s) < STICKS_M_S:
            block.sticks_N += laws.breakaway_N(axis)
    last = len(rollers) - 1
    speed_m_s = motion[last].speed_m_s
    dragged_N = f.idlers_viscous * speed_m_s
    dragged_N += f.idlers_dry_N * measured_direction(speed_m_s, laws.FRICTION_WIDTH_M_S)
    block.tension_N -= dragged_N + f.idlers_kg * motion[last].rate_m_s2
    block.variance_N2 += f.idlers_dry_N**2 + (f.idlers_viscous * speed_m_s) ** 2
    block.turning_N = turning_N2**0.5


@compiled
def _mean(values: Record, newest: int, first: int, count: int) -> float:
    """Mean of a quantity in the ring over `count` blocks, of which the newest is `first` blocks old."""
    total = 0.0
    for k in range(count):
        total += values[(newest - first - k) % BLOCKS]
    return total / count


@compiled
def _lasts_beyond(ring: Records, newest: int, around_N: float, bound_N: float) -> bool:
    """True if the twin is beyond the bound in the mean, and both halves agree; also for a value that is no number."""
    newer_N = _mean(ring.twin_N, newest, 0, _HALF) - _mean(ring.tension_N, newest, 0, _HALF) - around_N
    older_N = _mean(ring.twin_N, newest, _HALF, _HALF) - _mean(ring.tension_N, newest, _HALF, _HALF) - around_N
    if abs(newer_N) < 0.5 * bound_N or abs(older_N) < 0.5 * bound_N or newer_N * older_N < 0.0:
        return False
    return not 0.5 * abs(newer_N + older_N) <= bound_N


@compiled
def _has_stepped(ring: Records, newest: int) -> bool:
    """True if E by torques and encoders has changed within the ring, and the twin's has followed."""
    stretch_m2 = _mean(ring.stretch_m2, newest, 0, _HALF), _mean(ring.stretch_m2, newest, _HALF, _HALF)
    if not (stretch_m2[0] > 0.0 and stretch_m2[1] > 0.0):
        return False
    newer_Pa = _mean(ring.tension_N, newest, 0, _HALF) / stretch_m2[0]
    older_Pa = _mean(ring.tension_N, newest, _HALF, _HALF) / stretch_m2[1]
    if not older_Pa > 0.0:
        return False
    by_torques = newer_Pa / older_Pa - 1.0
    by_twin = _mean(ring.twin_Pa, newest, 0, _HALF) / _mean(ring.twin_Pa, newest, _HALF, _HALF) - 1.0
    return abs(by_torques) > _STEP_SHARE and by_twin * by_torques > _FOLLOWED * by_torques**2


@compiled
def _learn(f: Record, s: Record, ring: Records, block: Record, newest: int) -> None:
    """Learn the difference of the twin's tension from that of the torques while nothing changes."""
    if block.unchanged == 0.0 or block.closed == 0.0 or f.changes == 0.0:
        s.constant_s, s.known = 0.0, 0.0
        return
    s.constant_s += block.block_s
    if _has_stepped(ring, newest):
        s.constant_s, s.known = _SETTLED_S - _AFTER_STEP_S, 0.0
    difference_N = _mean(ring.twin_N, newest, 0, BLOCKS) - _mean(ring.tension_N, newest, 0, BLOCKS)
    if not np.isfinite(difference_N):
        return
    if s.known == 0.0 and s.constant_s >= _SETTLED_S and s.filled >= BLOCKS:
        s.known, s.difference_N, s.known_at_m_s = 1.0, difference_N, block.line_m_s
        s.learned, s.interval_s, s.least_N, s.most_N = 1.0, 0.0, difference_N, difference_N
        s.swings_N, s.swung_N = -1.0, -1.0
    elif s.known != 0.0 and s.beyond_s == 0.0:
        _refine(f, s, block, difference_N)


@compiled
def _refine(f: Record, s: Record, block: Record, difference_N: float) -> None:
    """The known difference, by one more block."""
    off_N = difference_N - s.difference_N
    most_N = _WARMING_DEVIATIONS * f.warms_N * block.block_s / _WARMS_UP_S
    s.learned += 1.0
    if s.learned < _LEARNING_BLOCKS:
        most_N = max(most_N, abs(off_N) / s.learned)
    s.difference_N += min(max(off_N, -most_N), most_N)
    s.least_N, s.most_N = min(s.least_N, difference_N), max(s.most_N, difference_N)
    s.interval_s += block.block_s
    if s.interval_s >= _INTERVAL_S:
        s.swung_N, s.swings_N = s.swings_N, 0.5 * (s.most_N - s.least_N)
        s.interval_s, s.least_N, s.most_N = 0.0, difference_N, difference_N


@compiled
def judge(f: Record, s: Record, ring: Records, block: Record) -> bool:
    """Take a block. True if the verdict on the twin changes, or the E of an open loop (ASSUMED_PA).
    `f`: SPAN, `s`: STATE, `ring` (BLOCKS,) and `block`: BLOCK."""
    newest = int(s.next)
    if block.closed == 0.0 and s.reported == NOTHING:  # another reason holds the loop open: the twin is not used
        s.filled, s.constant_s, s.known, s.beyond_s = 0.0, 0.0, 0.0, 0.0
        return False
    ring[newest] = block
    s.next, s.filled = (newest + 1) % BLOCKS, min(s.filled + 1.0, BLOCKS)
    if s.filled < BLOCKS:
        return False
    if s.reported == NOTHING:
        _learn(f, s, ring, block, newest)
    found = _find(f, s, ring, newest)
    if s.reported == NOTHING:
        s.beyond_s = s.beyond_s + block.block_s if found != NOTHING else 0.0
        if s.beyond_s < PERSISTS_S:
            return False
        s.reported, s.back_s, s.assumed_Pa = found, 0.0, s.by_torques_Pa
        return True
    comparable = _is_comparable(s, block)
    s.back_s = s.back_s + block.block_s if found == NOTHING and comparable else 0.0
    if s.back_s >= _RETURN_S:
        forget(s)
        return True
    if not (comparable and block.unchanged != 0.0 and s.by_torques_Pa > 0.0):
        return False
    if abs(s.by_torques_Pa / s.assumed_Pa - 1.0) <= _WORTH_TELLING:
        return False
    s.assumed_Pa = s.by_torques_Pa
    return True


@compiled
def _is_comparable(s: Record, block: Record) -> bool:
    """True if the known difference applies at this speed: not where a roller may stick, or has turned
    back."""
    known_m_s, now_m_s = s.known_at_m_s, block.line_m_s
    if abs(known_m_s) < STICKS_M_S or abs(now_m_s) < STICKS_M_S:
        return bool(s.known == 0.0 or max(abs(known_m_s), abs(now_m_s)) < STICKS_M_S)
    return bool(s.known == 0.0 or known_m_s * now_m_s > 0.0)


@compiled
def _find(f: Record, s: Record, ring: Records, newest: int) -> float:
    """Verdict: which quantity of the twin is beyond its interval; both are left in the state."""
    share = 1.0 if s.reported == NOTHING else _RETURN_SHARE
    tension_N = _mean(ring.tension_N, newest, 0, BLOCKS)
    turning_N = _mean(ring.turning_N, newest, 0, BLOCKS)
    lacks_N = DEVIATIONS * (_mean(ring.variance_N2, newest, 0, BLOCKS) + turning_N**2) ** 0.5
    lacks_N += _mean(ring.sticks_N, newest, 0, BLOCKS)
    s.mean_N, s.mean_Pa = _mean(ring.twin_N, newest, 0, BLOCKS), _mean(ring.twin_Pa, newest, 0, BLOCKS)
    around_N = s.difference_N if s.known != 0.0 else 0.0
    stretch_m2 = _mean(ring.stretch_m2, newest, 0, BLOCKS)
    s.by_torques_Pa = s.mean_Pa * (tension_N + around_N) / s.mean_N if s.mean_N > 0.0 else 0.0
    if stretch_m2 > _LEAST_STRAIN * f.usual_m2 > 0.0:
        s.by_torques_Pa = (tension_N + around_N) / stretch_m2
    if s.known != 0.0:
        faster_m_s = abs(abs(ring[newest].line_m_s) - abs(s.known_at_m_s))
        bound_N = _CHANGE_SHARE * f.usual_N + _TURNING_DEVIATIONS * turning_N
        bound_N += min(s.swings_N, s.swung_N) if min(s.swings_N, s.swung_N) >= 0.0 else bound_N
        bound_N += f.of_speed * faster_m_s
        s.low_N, s.high_N = tension_N + around_N - bound_N, tension_N + around_N + bound_N
        if _lasts_beyond(ring, newest, around_N, share * bound_N):
            return CHANGE
    if s.reported != CHANGE:
        s.low_N, s.high_N = tension_N - lacks_N, tension_N + lacks_N
    if _lasts_beyond(ring, newest, 0.0, share * lacks_N):
        s.low_N, s.high_N = tension_N - lacks_N, tension_N + lacks_N
        return TENSION
    if not stretch_m2 > _LEAST_STRAIN * f.usual_m2 > 0.0:
        return NOTHING
    creep = f.creep_share * (tension_N - f.next_N) / f.usual_N
    strained = share * DEVIATIONS * (f.strain_share**2 + creep**2) ** 0.5
    s.low_Pa = (tension_N - share * lacks_N) / (stretch_m2 * (1.0 + strained))
    s.high_Pa = (tension_N + share * lacks_N) / (stretch_m2 * max(1.0 - strained, 1e-3))
    return NOTHING if s.low_Pa <= s.mean_Pa <= s.high_Pa else MODULUS


@compiled
def forget(s: Record) -> None:
    """Reset for a new twin: no verdict, nothing known."""
    s.reported, s.back_s = NOTHING, 0.0
    s.filled, s.constant_s, s.known, s.beyond_s = 0.0, 0.0, 0.0, 0.0
