"""Compiled cycle of `span_estimator`: compare, estimate by the bank of filters, transfer.

It runs in stages: `run` returns at a stage that needs the interpreter, and is called again from the following one. All
state is in `SpanEstimatorVectors`, owned by one span of one twin; it may be called from other compiled functions.
"""

from __future__ import annotations

from math import exp, hypot, inf, isfinite, isnan
from typing import NamedTuple

from hilbench.compiled import COUNT, REAL, TABLE, VECTOR, compiled, entry_point, floats, inlined, integers, reals
from hilbench.estimation import plausibility
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.web_line import (
    anomalies,
    balance,
    block_means,
    delay,
    initial_strains,
    torque_shift,
    unmodelled_effects,
    unmodelled_filter,
)
from hilbench.estimation.web_line.balance import BalanceVectors
from hilbench.estimation.web_line.synchronizers import changepoint
from hilbench.estimation.web_line.synchronizers.changepoint import BankVectors
from hilbench.estimation.web_line.synchronizers.plant import InputVectors
from hilbench.plant.web_line import laws, line_vectors
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line_vectors import LineVectors

#: Share of the tension from which on a sudden growth of the force correction restarts the change detectors.
_ALL_AT_ONCE = 0.002
#: Largest absolute strain of a measured state that is transferred: no web has more.
LARGEST_STRAIN = 0.5
#: Refusals of measured states that last longer are neither an encoder's jump nor a new E that is not found yet: the
#: simulation has diverged, s.
DIVERGED_S = 0.25

# Stages of a cycle; `run` returns the stage that needs the interpreter, or DONE.
COMPARE, HOLD, FOUND_WEB, UPDATE, LOOK_FOR_SHIFT, SHIFT, TRANSFER, DONE = range(8)

# State of a span estimator, SI; true is 1, false 0. Derived from model and config:
(
    CYCLE_S,
    FORCE_PER_TORQUE,
    SECTION_M2,
    SPAN_M,
    SPAN,  # of the line, from 0
    HAS_ERRORS,  # unmodelled effects are estimated
    BANK,  # the method is the bank of filters
    BLACK_BOX,  # E of the line stays
    COMPENSATES,  # shifts of the torque are looked for
    FINDS_DELAY,
    DELAYED,  # there may be a delay
    TRANSFERS_STRAIN,
    TRANSFERS_AXES,
    STRAIN_LIMIT,
    POSITION_LIMIT_M,
    VELOCITY_LIMIT_M_S,
    # What is known:
    MODULUS_PA,
    DEVIATION_PA,
    OWN_DEVIATION_PA,  # without unmodelled effects
    UNMODELLED_N,
    SHIFT_NM,
    DELAY_S,
    STRAIN_UNCERTAINTY,
    WEB_PER_PA,
    OTHER_WEB,  # E may be changing because other web comes in
    # Of the present cycle:
    MISSED_S,  # since the last measurement
    RUNS,  # the line has been simulated since the release
    TORQUE_NM,  # measured, less the shift
    TORQUE_SIM_NM,
    POSITION_1_M,
    POSITION_2_M,
    RESIDUAL_NM,
    PROBLEM,
    REFUSED,  # cycles in a row in which a measured state was not taken over
    REFUSED_M,  # web that has passed meanwhile
    SPLICED,
    SERIES_FACTOR,
    END_FACTOR,
    NOW_N,  # instantaneous force of the balance, compensated for unmodelled effects
    MEASURED,  # there is a balance
    USED,  # E was found from the next four: the balance at the time of the torque (delayed), uncompensated
    USED_M,
    USED_N,
    USED_PER_PA,
    USED_M_S,
    CORRECTED_N,  # the delayed force, compensated
    REBASED_PA,  # change of E by a change of the compensation
    MOVED,  # the motors' feedback has changed
    CREEP_RATIO,  # share by which the web leaves the span slower than the roller turns
    FOUND,  # the strain has just been initialized; the simulation had a guess
    FROZEN,  # cycle time uncertain: no adaptation
) = range(51)
SIZE = 51


class SpanEstimatorVectors(NamedTuple):
    """State vectors of a span estimator and of the line that it updates."""

    t: Vector
    plausibility: Vector
    anomalies: Vector
    shift: Vector
    delay_line: Vector
    delay_finder: Vector
    moduli: Vector  #: (2, S): parameter index of E of the spans that follow it, and its ratio
    balance: BalanceVectors
    errors: Vector  #: of the unmodelled effects
    bank: BankVectors
    line: LineVectors
    blocks: Vector


@compiled
def state_modulus(t: Vector, errors: Vector, modulus_Pa: float, deviation_Pa: float) -> None:
    """State E and its deviation, with that of unmodelled effects, which no method sees in its data. `errors`: state of
    the unmodelled effects."""
    t[OWN_DEVIATION_PA] = deviation_Pa
    if 0.0 < modulus_Pa < inf:
        t[MODULUS_PA] = modulus_Pa
    else:  # e.g. the torque of another web: no material has such an E
        t[OWN_DEVIATION_PA] = inf
    force_N = t[UNMODELLED_N] if t[HAS_ERRORS] == 0.0 else unmodelled_effects.record(errors).spread_N
    unmodelled_Pa = 0.0
    if force_N != 0.0:  # a web without strain has no information on E
        unmodelled_Pa = force_N / t[WEB_PER_PA] if t[WEB_PER_PA] != 0.0 else inf
    t[DEVIATION_PA] = hypot(t[OWN_DEVIATION_PA], unmodelled_Pa)


@compiled
def compare(
    v: SpanEstimatorVectors,
    x1_m: float,
    x2_m: float,
    torque_Nm: float,
    torque_sim_Nm: float,
    strain_prev: float,
    F_next_N: float,
    centre_m: float,
    strain_next: float,
    creep_ratio_prev: float,
) -> int:
    """Take the measurement of the instant that the line has been simulated to; the next stage: HOLD, FOUND_WEB or
    UPDATE.

    `torque_Nm`, `torque_sim_Nm`: measured and simulated; `centre_m`: position of the centre of mass, where roller 2
    represents several, else NaN; `strain_next`: strain of the web after the span, NaN at the end of the line;
    `creep_ratio_prev`: creep ratio at roller 1 (`CREEP_RATIO` of the previous span).
    """
    t, now = v.t, v.balance.s
    torque_Nm -= t[SHIFT_NM]
    balance.use_modulus(v.balance, t[MODULUS_PA])
    creep_per_N, behind_N = balance.creep_per_N(v.balance), F_next_N
    if creep_per_N != 0.0:
        behind_N = line_vectors.tension_behind_N(v.line, int(t[SPAN]), F_next_N)
    if isnan(strain_next):
        strain_next = laws.downstream_strain(v.balance.p, F_next_N)
    duration_s = t[CYCLE_S] + t[MISSED_S]
    around = strain_prev, F_next_N, behind_N, strain_next, creep_ratio_prev
    balance.momentum_balance(v.balance, x1_m, x2_m, torque_Nm, *around, duration_s)
    t[CREEP_RATIO] = creep_per_N * (balance.tension_N(v.balance) - behind_N) if creep_per_N != 0.0 else 0.0
    if not isnan(centre_m):
        now[balance.X2_M] = centre_m
    force_N, web_per_Pa, velocity_m_s = now[balance.FORCE_N], now[balance.WEB_PER_PA], now[balance.VELOCITY_M_S]
    t[MISSED_S] = 0.0
    t[TORQUE_NM] = torque_Nm
    t[TORQUE_SIM_NM] = torque_sim_Nm
    t[POSITION_1_M] = x1_m
    t[POSITION_2_M] = x2_m
    t[MEASURED] = 1.0
    t[USED] = 0.0
    t[REBASED_PA] = 0.0
    spliced, t[SERIES_FACTOR], t[END_FACTOR] = balance.spliced(v.balance)
    t[SPLICED] = 1.0 if spliced else 0.0
    t[NOW_N] = _without_errors(v, force_N)
    t[RESIDUAL_NM] = torque_Nm - torque_sim_Nm
    problem = plausibility.find_problem(v.plausibility, torque_Nm, web_per_Pa, velocity_m_s)
    if problem != 0 or t[FROZEN] != 0.0:
        _see_no_change_across(v)
    elif not t[STRAIN_UNCERTAINTY] > 0.0:  # no change to detect until its strain is known
        problem = _look_at_web(v, web_per_Pa, velocity_m_s)
    t[PROBLEM] = problem
    moved = _find_delay(v, torque_Nm, torque_sim_Nm)
    coherent = isfinite(force_N)
    t[USED_M], t[USED_N], t[USED_PER_PA], t[USED_M_S] = now[balance.X2_M], force_N, web_per_Pa, velocity_m_s
    if t[DELAYED] != 0.0:
        if coherent:
            coherent, t[USED_M], t[USED_N], t[USED_PER_PA], t[USED_M_S] = delay.pair(
                v.delay_line,
                now[balance.X2_M],
                force_N,
                web_per_Pa,
                velocity_m_s,
                torque_Nm * t[FORCE_PER_TORQUE],
                t[DELAY_S],
            )
        else:
            delay.forget(v.delay_line)
    usable = coherent and problem == 0 and not moved and t[FROZEN] == 0.0
    if t[STRAIN_UNCERTAINTY] > 0.0:
        _transport_out(t, velocity_m_s)
    if t[STRAIN_UNCERTAINTY] > 0.0:
        t[USED] = 1.0 if usable else 0.0
        return FOUND_WEB
    if not usable:
        return HOLD
    t[USED] = 1.0
    _look_for_errors(v, F_next_N)
    t[CORRECTED_N] = _without_errors(v, t[USED_N])
    return UPDATE


@compiled
def _see_no_change_across(v: SpanEstimatorVectors) -> None:
    """Restart the change detectors: no change is detected across this instant."""
    block_means.begin_behind_gap(v.blocks)
    anomalies.suspend(v.anomalies)


@compiled
def _look_at_web(v: SpanEstimatorVectors, web_per_Pa: float, velocity_m_s: float) -> int:
    """`Problem` of the web: broken or slipping; 0: neither."""
    if not (isfinite(v.t[NOW_N]) and isfinite(web_per_Pa)):
        block_means.begin(v.blocks)
        anomalies.reset(v.anomalies)
        return 0
    if block_means.take(v.blocks, v.t[NOW_N], web_per_Pa, velocity_m_s):
        anomalies.look(v.anomalies, v.blocks)
    return anomalies.found(v.anomalies)


@inlined
def _without_errors(v: SpanEstimatorVectors, force_N: float) -> float:
    """Force compensated for unmodelled effects."""
    if v.t[HAS_ERRORS] == 0.0:
        return force_N
    return float(force_N - unmodelled_effects.correction_N(v.errors))


@compiled
def _find_delay(v: SpanEstimatorVectors, torque_Nm: float, torque_sim_Nm: float) -> bool:
    """Update the torque delay; True if it changes from this cycle on."""
    if v.t[FINDS_DELAY] == 0.0 or v.t[PROBLEM] != 0.0:
        return False
    before_s = v.t[DELAY_S]
    v.t[DELAY_S] = delay.find(v.delay_finder, torque_Nm, torque_sim_Nm)
    # Torque and motion of different instants: discard what the error filter has learned from them.
    if v.t[HAS_ERRORS] != 0.0 and abs(v.t[DELAY_S] - before_s) >= v.t[CYCLE_S]:
        unmodelled_filter.forget(unmodelled_effects.record(v.errors))
    return bool(v.t[DELAY_S] != before_s)


@inlined
def _transport_out(t: Array, velocity_m_s: float) -> None:
    """Decay of the strain uncertainty by mass transport: exp(-v·t/L)."""
    t[STRAIN_UNCERTAINTY] *= exp(-abs(velocity_m_s) * t[CYCLE_S] / t[SPAN_M])
    if t[STRAIN_UNCERTAINTY] < initial_strains.KNOWN:
        t[STRAIN_UNCERTAINTY] = 0.0


@compiled
def _look_for_errors(v: SpanEstimatorVectors, F_next_N: float) -> None:
    """Update the unmodelled effects; E is rebased if the force correction has changed."""
    t, errors = v.t, unmodelled_effects.record(v.errors)
    if t[HAS_ERRORS] == 0.0:
        return
    # The share of other web in the span is uncertain: no information on the model's errors.
    if t[SPLICED] != 0.0 or t[OTHER_WEB] != 0.0:
        unmodelled_filter.interrupt(errors)
        return
    web_per_Pa = t[USED_PER_PA]
    unmodelled_filter.take(
        errors,
        t[POSITION_1_M],
        t[USED_M],
        t[TORQUE_NM],
        t[USED_N],
        web_per_Pa,
        t[USED_M_S],
        F_next_N,
        t[MODULUS_PA],
    )
    rebased_N = errors.rebased_N
    if rebased_N != 0.0 and web_per_Pa > 0.0:
        t[REBASED_PA] = -rebased_N / web_per_Pa
        # A sudden growth of the correction is no change of the web.
        if abs(rebased_N) > _ALL_AT_ONCE * t[MODULUS_PA] * web_per_Pa:
            _see_no_change_across(v)
            torque_shift.reset(v.shift)


@compiled
def update(v: SpanEstimatorVectors) -> None:
    """Bank's part of the stage UPDATE."""
    t = v.t
    if t[REBASED_PA] != 0.0:
        changepoint.rebase(v.bank, t[REBASED_PA])
    t[WEB_PER_PA] = t[USED_PER_PA]
    used = (t[USED_M], t[CORRECTED_N], t[USED_PER_PA], t[USED_M_S])
    if changepoint.follow(v.bank, t[CYCLE_S], t[TORQUE_NM], used[0], used[1], used[2], used[3]):
        changepoint.set_held_share(v.bank, 0.0)
    modulus_Pa, deviation_Pa = changepoint.stated(v.bank)
    state_modulus(t, v.errors, modulus_Pa, deviation_Pa)


@compiled
def look_for_shift(v: SpanEstimatorVectors) -> int:
    """Next stage: SHIFT if a torque shift is certain, else TRANSFER."""
    t, block = v.t, v.blocks
    if t[COMPENSATES] == 0.0:
        return TRANSFER
    if t[PROBLEM] != 0.0 or t[STRAIN_UNCERTAINTY] > 0.0:
        torque_shift.reset(v.shift)
        return TRANSFER
    if block[block_means.READY] == 0.0:
        return TRANSFER
    found = torque_shift.look(
        v.shift,
        block[block_means.FORCE_N],
        block[block_means.WEB_PER_PA],
        block[block_means.VELOCITY_M_S],
        t[MODULUS_PA],
        not anomalies.is_judging(v.anomalies),
        unmodelled_filter.likely_deviation_N(unmodelled_effects.record(v.errors)) if t[HAS_ERRORS] != 0.0 else 0.0,
    )
    return SHIFT if found else TRANSFER


@compiled
def transfer(v: SpanEstimatorVectors) -> None:
    """Set E of the line and transfer plausible measured states to it; count cycles and travel of refused ones."""
    t, line = v.t, v.line
    v1_m_s, v2_m_s = balance.roller_speed_m_s(v.balance, 0), balance.roller_speed_m_s(v.balance, 1)
    t[MOVED] = 0.0
    if t[BLACK_BOX] == 0.0:
        for i in range(v.moduli.shape[1]):
            line.p[int(v.moduli[0, i])] = v.moduli[1, i] * (t[SERIES_FACTOR] * t[MODULUS_PA])
    if t[RUNS] == 0.0:
        t[RUNS] = 1.0
        return
    at, changed, refused = int(t[SPAN]), False, False
    if t[TRANSFERS_STRAIN] != 0.0 and t[BLACK_BOX] == 0.0:
        measured = balance.strain(v.balance)
        # No web strains as much: encoders get there at implausible speeds, and -1 would be a web of length 0.
        believable = abs(measured) <= LARGEST_STRAIN
        if believable and (t[FOUND] != 0.0 or abs(measured - line_vectors.strain(line, at)) <= t[STRAIN_LIMIT]):
            line_vectors.put_strain(line, at, measured)
            changed, t[FOUND] = True, 0.0
        else:
            refused = True
    if t[TRANSFERS_AXES] != 0.0 or t[BLACK_BOX] != 0.0:
        if line_vectors.is_near(line, at, t[POSITION_1_M], t[POSITION_2_M], t[POSITION_LIMIT_M]) and (
            line_vectors.is_as_fast(line, at, v1_m_s, v2_m_s, t[VELOCITY_LIMIT_M_S])
        ):
            line_vectors.put_motion(line, at, t[POSITION_1_M], v1_m_s)
            line_vectors.put_motion(line, at + 1, t[POSITION_2_M], v2_m_s)
            changed = True
            t[MOVED] = 1.0
        else:
            refused = True
    t[REFUSED] = t[REFUSED] + 1.0 if refused else 0.0
    t[REFUSED_M] = t[REFUSED_M] + abs(v1_m_s) * t[CYCLE_S] if refused else 0.0
    if changed:
        line_vectors.show(line)
        if line_vectors.reports(line):
            t[MOVED] = 1.0


@compiled
def run(
    v: SpanEstimatorVectors,
    stage: int,
    x1_m: float,
    x2_m: float,
    torque_Nm: float,
    torque_sim_Nm: float,
    strain_prev: float,
    F_next_N: float,
    centre_m: float,
    strain_next: float,
    creep_ratio_prev: float,
) -> int:
    """Run a cycle from `stage` on; arguments as of `compare`, which alone reads them. Returns the stage that needs the
    interpreter (HOLD, FOUND_WEB, UPDATE of a method other than the bank, SHIFT), or DONE."""
    if stage == COMPARE:
        around = strain_prev, F_next_N, centre_m, strain_next, creep_ratio_prev
        stage = compare(v, x1_m, x2_m, torque_Nm, torque_sim_Nm, *around)
        if stage == UPDATE and v.t[BANK] != 0.0:
            update(v)
            stage = LOOK_FOR_SHIFT
    if stage == LOOK_FOR_SHIFT:
        stage = look_for_shift(v)
    if stage == TRANSFER:
        transfer(v)
        stage = DONE
    return stage


@compiled
def measured_strain(table: Places) -> float:
    """Strain by the encoders, from the table of `flat`."""
    return float(floats(table, WEB_ROW + 4, (1,))[balance.STRAIN])


@compiled
def outlet_strain(t: Vector, strain: float) -> float:
    """Inlet strain of the next span: measured strain × series factor / end factor, as all pieces carry the same
    tension, corrected for creep."""
    return float(equivalent_strain(strain * t[SERIES_FACTOR] / t[END_FACTOR], t[CREEP_RATIO]))


@inlined
def equivalent_strain(strain: float, creep_ratio: float) -> float:
    """Strain with the same mass flow as web creeping by `creep_ratio`: (1 + ε)/(1 − c) − 1."""
    return strain if creep_ratio == 0.0 else (1.0 + strain) / (1.0 - creep_ratio) - 1.0


@inlined
def reverse_outlet_strain(t: Vector, strain: float) -> float:
    """Inlet strain of the previous span in reverse: measured strain × series factor."""
    return float(strain * t[SERIES_FACTOR])


@compiled
def is_synchronized(t: Vector, most_pct: float) -> bool:
    """True if E is known to `most_pct`, the measured web is in the span, and the simulated web has its strain."""
    known = t[PROBLEM] == 0.0 and t[STRAIN_UNCERTAINTY] == 0.0 and t[REFUSED] * t[CYCLE_S] <= DIVERGED_S
    return bool(known and t[OWN_DEVIATION_PA] <= 0.01 * most_pct * t[MODULUS_PA])


#: Rows in the table of `flat`: the state; the shift detector's state; parameters, state, inputs, scratch space and
#: outputs of the measured web, and of the line, in a row; number of rows. Inputs, offsets and mixture of the bank.
STATE_ROW, SHIFT_ROW, WEB_ROW, LINE_ROW, ROWS = 0, 3, 8, 28, 34
BANK_INPUTS_ROW, BANK_PLACES_ROW, BANK_OUT_ROW = 15, 23, 25


def flat(v: SpanEstimatorVectors) -> tuple[Array | Places, ...]:
    """Vectors in the order of the table of `run_vectors`."""
    balance_p, web, balance_s = v.balance
    return (*v[:7], balance_p, *web, balance_s, v.errors, *v.bank[0], *v.bank[1:], *v.line, v.blocks)


# Reason of a reset: a cycle is missing; the web is the same with a better estimate; it is another web.
INTERRUPT, SUSPEND, NEW_WEB = range(3)


@entry_point(COUNT, reals(9), TABLE)
def run_vectors(stage: int, values: tuple[float, ...], table: Places) -> int:
    """`run` on the vectors in a `table_of` the result of `flat`."""
    web = LineVectors(
        floats(table, 8, (1,)),
        floats(table, 9, (1,)),
        floats(table, 10, (1,)),
        floats(table, 11, (1,)),
        floats(table, 12, (1,)),
    )
    inputs = InputVectors(
        floats(table, 15, (1,)), floats(table, 16, (1,)), floats(table, 17, (1,)), floats(table, 18, (1,))
    )
    hypotheses = BankVectors(
        inputs,
        floats(table, 19, (1, 2)),
        floats(table, 20, (1, 2, 3)),
        floats(table, 21, (1, 2)),
        floats(table, 22, (1,)),
        integers(table, 23, (1,)),
        floats(table, 24, (1, 2)),
        floats(table, 25, (1, 2)),
        floats(table, 26, (1, 2)),
        floats(table, 27, (1,)),
    )
    line = LineVectors(
        floats(table, 28, (1,)),
        floats(table, 29, (1,)),
        floats(table, 30, (1,)),
        floats(table, 31, (1,)),
        floats(table, 32, (1,)),
    )
    v = SpanEstimatorVectors(
        floats(table, 0, (1,)),
        floats(table, 1, (1,)),
        floats(table, 2, (1,)),
        floats(table, 3, (1,)),
        floats(table, 4, (1,)),
        floats(table, 5, (1,)),
        floats(table, 6, (1, 2)),
        BalanceVectors(floats(table, 7, (1,)), web, floats(table, 13, (1,))),
        floats(table, 14, (1,)),
        hypotheses,
        line,
        floats(table, 33, (1,)),
    )
    return run(v, stage, *values)


@entry_point(COUNT, VECTOR, VECTOR, VECTOR, VECTOR)
def forget(what: int, block: Vector, of_anomalies: Vector, shift: Vector, delay_line: Vector) -> None:
    if what == INTERRUPT:
        block_means.miss(block)
        return
    torque_shift.reset(shift)
    if what == SUSPEND:
        block_means.begin_behind_gap(block)
        anomalies.suspend(of_anomalies)
    else:
        block_means.begin(block)
        anomalies.reset(of_anomalies)
        delay.forget(delay_line)


@entry_point(VECTOR, VECTOR, REAL, REAL)
def state(t: Vector, errors: Vector, modulus_Pa: float, deviation_Pa: float) -> None:
    state_modulus(t, errors, modulus_Pa, deviation_Pa)
