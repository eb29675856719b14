"""Compiled cycle of `span_estimator`: compare, estimate by the bank of filters, transfer.

It runs in stages: `run_arrays` returns at a stage that needs the interpreter, and is called again from the following
one. All state is in `SpanEstimatorArrays`, owned by one span of one twin; it may be called from other compiled
functions.
"""

from __future__ import annotations

from math import exp, hypot, inf, isfinite, isnan
from typing import Annotated, Any, Final, NamedTuple

from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals2,
    Record,
    arrays_in,
    compiled,
    entry_point,
    inlined,
    reals,
    record_type,
    rows_of,
)
from hilbench.estimation import plausibility
from hilbench.estimation.bank import Places
from hilbench.estimation.web_line import (
    anomalies,
    balance,
    block_means,
    delay,
    initial_strains,
    torque_shift,
    unmodelled_filter,
)
from hilbench.estimation.web_line.balance import BalanceVectors
from hilbench.estimation.web_line.synchronizers import filters
from hilbench.estimation.web_line.synchronizers.filters import FilterArrays
from hilbench.plant.web_line import laws, line_vectors, records
from hilbench.plant.web_line.line_vectors import LineVectors

#: Share of the tension from which on a sudden growth of the force correction restarts the change detectors.
_ALL_AT_ONCE = 0.002
#: Largest absolute strain of a measured state that is transferred: no web has more.
LARGEST_STRAIN = 0.5
#: Refusals of measured states that last longer are neither an encoder's jump nor a new E that is not found yet: the
#: simulation has diverged, s. Without measurements for as long it follows nothing.
DIVERGED_S = 0.25

# Stages of a cycle; `run_arrays` returns the stage that needs the interpreter, or DONE.
COMPARE, HOLD, FOUND_WEB, UPDATE, LOOK_FOR_SHIFT, SHIFT, TRANSFER, DONE = range(8)
#: Reasons to restart the detectors: a cycle is missing; the web is the same with a better estimate; it is another web.
#: And E is stated, by a method in Python.
INTERRUPT, SUSPEND, NEW_WEB, STATE = range(DONE + 1, DONE + 5)

#: State of a span estimator, SI; true is 1, false 0.
SPAN: Final = record_type(
    # Derived from model and config: number of the span in the line, from 0; whether unmodelled effects are estimated;
    # the method is the bank of filters, or leaves E of the line (`black_box`); shifts of the torque and a delay are
    # looked for, or there may be a delay; what is transferred.
    *("cycle_s", "force_per_torque", "section_m2", "span_m", "span", "has_errors", "bank", "black_box", "compensates"),
    *("finds_delay", "delayed", "transfers_strain", "transfers_axes", "strain_limit", "position_limit_m"),
    "velocity_limit_m_s",
    # What is known; `own_deviation_Pa` is without unmodelled effects; with `other_web` E may be changing because other
    # web comes in.
    *("modulus_Pa", "deviation_Pa", "own_deviation_Pa", "unmodelled_N", "shift_Nm", "delay_s", "strain_uncertainty"),
    *("web_per_Pa", "other_web"),
    # Of the present cycle: time since the last measurement; whether the line has been simulated since the release;
    # torques less the shift; cycles in a row in which a measured state was refused, and the web that has passed
    # meanwhile; instantaneous force, compensated for unmodelled effects; whether there is a balance.
    *("missed_s", "runs", "torque_Nm", "torque_sim_Nm", "position_1_m", "position_2_m", "residual_Nm", "problem"),
    *("refused", "refused_m", "spliced", "series_factor", "end_factor", "now_N", "measured"),
    # E was found from the next four: the balance at the (delayed) time of the torque, uncompensated; then the delayed
    # force, compensated, and the change of E by a change of the compensation.
    *("used", "used_m", "used_N", "used_per_Pa", "used_m_s", "corrected_N", "rebased_Pa"),
    # The motors' feedback has changed; share by which the web leaves the span slower than the roller turns; the strain
    # has just been initialized, the simulation had a guess; cycle time uncertain: no adaptation.
    *("moved", "creep_ratio", "found", "frozen"),
)


class SpanEstimatorArrays(NamedTuple):
    """State of a span estimator and of the line that it updates."""

    t: Annotated[Any, SPAN]
    plausibility: Annotated[Any, plausibility.PLAUSIBILITY]
    anomalies: Annotated[Any, anomalies.ANOMALIES]
    shift: Annotated[Any, torque_shift.SHIFT]
    delay_line: delay.DelayLine
    delay_finder: delay.DelayFinder
    moduli: Reals2  #: (2, S): parameter index of E of the spans that follow it, and its ratio
    balance: BalanceVectors
    errors: Annotated[Any, unmodelled_filter.FILTER]
    filters: FilterArrays
    line: LineVectors
    blocks: Annotated[Any, block_means.BLOCK]


@compiled
def _state_modulus(v: SpanEstimatorArrays, modulus_Pa: float, deviation_Pa: float) -> None:
    """State E and its deviation, with that of unmodelled effects, which no method sees in its data."""
    t = v.t
    t.own_deviation_Pa = deviation_Pa
    if 0.0 < modulus_Pa < inf:
        t.modulus_Pa = modulus_Pa
    else:  # e.g. the torque of another web: no material has such an E
        t.own_deviation_Pa = inf
    force_N = t.unmodelled_N if t.has_errors == 0.0 else v.errors.spread_N
    unmodelled_Pa = 0.0
    if force_N != 0.0:  # a web without strain has no information on E
        unmodelled_Pa = force_N / t.web_per_Pa if t.web_per_Pa != 0.0 else inf
    t.deviation_Pa = hypot(t.own_deviation_Pa, unmodelled_Pa)


@compiled
def _compare(v: SpanEstimatorArrays, measured: tuple[float, ...]) -> int:
    """Take the measurement of the instant that the line has been simulated to (`run_arrays`); the next stage: HOLD,
    FOUND_WEB or UPDATE."""
    x1_m, x2_m, torque_Nm, torque_sim_Nm, strain_prev, F_next_N, centre_m, strain_next, creep_ratio_prev = measured
    t, now = v.t, v.balance.s
    torque_Nm -= t.shift_Nm
    balance.use_modulus(v.balance, t.modulus_Pa)
    creep_per_N, behind_N = balance.creep_per_N(v.balance), F_next_N
    if creep_per_N != 0.0:
        behind_N, behind = F_next_N, int(t.span) + 1
        if behind < line_vectors.arrays(v.line).k:
            behind_N = line_vectors.tension_N(v.line, behind)
    if isnan(strain_next):
        strain_next = laws.downstream_strain(records.web(records.of_parameters(v.balance.p)), F_next_N)
    duration_s = t.cycle_s + t.missed_s
    around = strain_prev, F_next_N, behind_N, strain_next, creep_ratio_prev
    balance.momentum_balance(v.balance, x1_m, x2_m, torque_Nm, around, duration_s)
    t.creep_ratio = creep_per_N * (balance.tension_N(v.balance) - behind_N) if creep_per_N != 0.0 else 0.0
    if not isnan(centre_m):
        now.x2_m = centre_m
    force_N, web_per_Pa, velocity_m_s = now.force_N, now.web_per_Pa, now.velocity_m_s
    t.missed_s = 0.0
    t.torque_Nm = torque_Nm
    t.torque_sim_Nm = torque_sim_Nm
    t.position_1_m = x1_m
    t.position_2_m = x2_m
    t.measured = 1.0
    t.used = 0.0
    t.rebased_Pa = 0.0
    spliced, t.series_factor, t.end_factor = balance.spliced(v.balance)
    t.spliced = 1.0 if spliced else 0.0
    t.now_N = _without_errors(v, force_N)
    t.residual_Nm = torque_Nm - torque_sim_Nm
    problem = plausibility.find_problem(v.plausibility, torque_Nm, web_per_Pa, velocity_m_s)
    if problem != 0 or t.frozen != 0.0:
        _see_no_change_across(v)
    elif not t.strain_uncertainty > 0.0:  # no change to detect until its strain is known
        problem = _look_at_web(v, web_per_Pa, velocity_m_s)
    t.problem = problem
    moved = _find_delay(v, torque_Nm, torque_sim_Nm)
    coherent = isfinite(force_N)
    t.used_m, t.used_N, t.used_per_Pa, t.used_m_s = now.x2_m, force_N, web_per_Pa, velocity_m_s
    if t.delayed != 0.0:
        if coherent:
            coherent, t.used_m, t.used_N, t.used_per_Pa, t.used_m_s = delay.pair(
                v.delay_line, now.x2_m, force_N, web_per_Pa, velocity_m_s, torque_Nm * t.force_per_torque, t.delay_s
            )
        else:
            delay.forget(v.delay_line)
    usable = coherent and problem == 0 and not moved and t.frozen == 0.0
    if t.strain_uncertainty > 0.0:
        # Mass transport: exp(-v·t/L).
        t.strain_uncertainty *= exp(-abs(velocity_m_s) * t.cycle_s / t.span_m)
        if t.strain_uncertainty < initial_strains.KNOWN:
            t.strain_uncertainty = 0.0
    if t.strain_uncertainty > 0.0:
        t.used = 1.0 if usable else 0.0
        return FOUND_WEB
    if not usable:
        return HOLD
    t.used = 1.0
    _look_for_errors(v, F_next_N)
    t.corrected_N = _without_errors(v, t.used_N)
    return UPDATE


@compiled
def _see_no_change_across(v: SpanEstimatorArrays) -> None:
    """Restart the change detectors: no change is detected across this instant."""
    block_means.begin_behind_gap(v.blocks)
    anomalies.suspend(v.anomalies)


@compiled
def _look_at_web(v: SpanEstimatorArrays, web_per_Pa: float, velocity_m_s: float) -> int:
    """`Problem` of the web: broken or slipping; 0: neither."""
    if not (isfinite(v.t.now_N) and isfinite(web_per_Pa)):
        block_means.begin(v.blocks)
        anomalies.reset(v.anomalies)
        return 0
    if block_means.take(v.blocks, v.t.now_N, web_per_Pa, velocity_m_s):
        anomalies.look(v.anomalies, v.blocks)
    return anomalies.found(v.anomalies)


@inlined
def _without_errors(v: SpanEstimatorArrays, force_N: float) -> float:
    """Force compensated for unmodelled effects."""
    if v.t.has_errors == 0.0:
        return force_N
    return float(force_N - v.errors.correction_N)


@compiled
def _find_delay(v: SpanEstimatorArrays, torque_Nm: float, torque_sim_Nm: float) -> bool:
    """Update the torque delay; True if it changes from this cycle on."""
    if v.t.finds_delay == 0.0 or v.t.problem != 0.0:
        return False
    before_s = v.t.delay_s
    v.t.delay_s = delay.find(v.delay_finder, torque_Nm, torque_sim_Nm)
    # Torque and motion of different instants: discard what the error filter has learned from them.
    if v.t.has_errors != 0.0 and abs(v.t.delay_s - before_s) >= v.t.cycle_s:
        unmodelled_filter.forget(v.errors)
    return bool(v.t.delay_s != before_s)


@compiled
def _look_for_errors(v: SpanEstimatorArrays, F_next_N: float) -> None:
    """Update the unmodelled effects; E is rebased if the force correction has changed."""
    t, errors = v.t, v.errors
    if t.has_errors == 0.0:
        return
    # The share of other web in the span is uncertain: no information on the model's errors.
    if t.spliced != 0.0 or t.other_web != 0.0:
        unmodelled_filter.interrupt(errors)
        return
    web_per_Pa = t.used_per_Pa
    unmodelled_filter.take(
        errors, t.position_1_m, t.used_m, t.torque_Nm, t.used_N, web_per_Pa, t.used_m_s, F_next_N, t.modulus_Pa
    )
    rebased_N = errors.rebased_N
    if rebased_N != 0.0 and web_per_Pa > 0.0:
        t.rebased_Pa = -rebased_N / web_per_Pa
        # A sudden growth of the correction is no change of the web.
        if abs(rebased_N) > _ALL_AT_ONCE * t.modulus_Pa * web_per_Pa:
            _see_no_change_across(v)
            torque_shift.reset(v.shift)


@compiled
def _update(v: SpanEstimatorArrays) -> None:
    """Bank's part of the stage UPDATE."""
    t = v.t
    if t.rebased_Pa != 0.0:
        filters.rebase(v.filters, t.rebased_Pa)
    t.web_per_Pa = t.used_per_Pa
    sample = t.cycle_s, t.torque_Nm, t.used_m, t.corrected_N, t.used_per_Pa, t.used_m_s
    if filters.follow(v.filters, sample):
        filters.state(v.filters, 0.0)
    modulus_Pa, deviation_Pa = filters.stated(v.filters)
    _state_modulus(v, modulus_Pa, deviation_Pa)


@compiled
def _look_for_shift(v: SpanEstimatorArrays) -> int:
    """Next stage: SHIFT if a torque shift is certain, else TRANSFER."""
    t, block = v.t, v.blocks
    if t.compensates == 0.0:
        return TRANSFER
    if t.problem != 0.0 or t.strain_uncertainty > 0.0:
        torque_shift.reset(v.shift)
        return TRANSFER
    if block.ready == 0.0:
        return TRANSFER
    found = torque_shift.look(
        v.shift,
        block.force_N,
        block.web_per_Pa,
        block.velocity_m_s,
        t.modulus_Pa,
        not anomalies.is_judging(v.anomalies),
        unmodelled_filter.likely_deviation_N(v.errors) if t.has_errors != 0.0 else 0.0,
    )
    return SHIFT if found else TRANSFER


@compiled
def _transfer(v: SpanEstimatorArrays) -> None:
    """Set E of the line and transfer plausible measured states to it; count cycles and travel of refused ones."""
    t, line = v.t, v.line
    v1_m_s, v2_m_s = balance.roller_speed_m_s(v.balance, 0), balance.roller_speed_m_s(v.balance, 1)
    t.moved = 0.0
    if t.black_box == 0.0:
        for i in range(v.moduli.shape[1]):
            line.p[int(v.moduli[0, i])] = v.moduli[1, i] * (t.series_factor * t.modulus_Pa)
    if t.runs == 0.0:
        t.runs = 1.0
        return
    at, changed, refused = int(t.span), False, False
    if t.transfers_strain != 0.0 and t.black_box == 0.0:
        measured = balance.strain(v.balance)
        # No web strains as much: encoders get there at implausible speeds, and -1 would be a web of length 0.
        believable = abs(measured) <= LARGEST_STRAIN
        if believable and (t.found != 0.0 or abs(measured - line_vectors.strain(line, at)) <= t.strain_limit):
            line_vectors.put_strain(line, at, measured)
            changed, t.found = True, 0.0
        else:
            refused = True
    if t.transfers_axes != 0.0 or t.black_box != 0.0:
        speeds = line_vectors.arrays(line).m + at
        if line_vectors.is_as_at(line, at, t.position_1_m, t.position_2_m, t.position_limit_m) and (
            line_vectors.is_as_at(line, speeds, v1_m_s, v2_m_s, t.velocity_limit_m_s)
        ):
            line_vectors.put_motion(line, at, t.position_1_m, v1_m_s)
            line_vectors.put_motion(line, at + 1, t.position_2_m, v2_m_s)
            changed = True
            t.moved = 1.0
        else:
            refused = True
    t.refused = t.refused + 1.0 if refused else 0.0
    t.refused_m = t.refused_m + abs(v1_m_s) * t.cycle_s if refused else 0.0
    if changed:
        line_vectors.show(line)
        if records.call(line_vectors.arrays(line)).reports != 0.0:
            t.moved = 1.0


@inlined
def equivalent_strain(strain: float, creep_ratio: float) -> float:
    """Strain with the same mass flow as web creeping by `creep_ratio`: (1 + ε)/(1 − c) − 1."""
    return strain if creep_ratio == 0.0 else (1.0 + strain) / (1.0 - creep_ratio) - 1.0


@compiled
def is_synchronized(t: Record, most_pct: float) -> bool:
    """True if E is known to `most_pct`, the measured web is in the span, and the simulated web has its strain."""
    follows = max(t.refused * t.cycle_s, t.missed_s) <= DIVERGED_S
    known = t.problem == 0.0 and t.strain_uncertainty == 0.0 and follows
    return bool(known and t.own_deviation_Pa <= 0.01 * most_pct * t.modulus_Pa)


@compiled
def _forget(v: SpanEstimatorArrays, what: int) -> None:
    """Restart the detectors, for the reason of a stage INTERRUPT, SUSPEND or NEW_WEB."""
    if what == INTERRUPT:
        block_means.miss(v.blocks)
        return
    torque_shift.reset(v.shift)
    if what == SUSPEND:
        _see_no_change_across(v)
    else:
        block_means.begin(v.blocks)
        anomalies.reset(v.anomalies)
        delay.forget(v.delay_line)


#: Rows of the table of a span estimator.
ROWS: Final = rows_of(SpanEstimatorArrays)


@entry_point(COUNT, reals(9), TABLE)
def run_arrays(stage: int, values: tuple[float, ...], table: Places) -> int:
    """Run a cycle from `stage` on, on the `SpanEstimatorArrays` in a table. Returns the stage that needs the
    interpreter (HOLD, FOUND_WEB, UPDATE of a method other than the bank, SHIFT), or DONE. Or, as stages of their own,
    its detectors are restarted, or E is stated with its deviation.

    `values` to COMPARE: positions of the rollers at the web; torque, measured and simulated; strain of the web that
    enters, tension after the line; position of the centre of mass, where roller 2 represents several, else NaN; strain
    of the web after the span, NaN at the end of the line; creep ratio at roller 1 (that of the previous span).
    """
    v = arrays_in(table, SpanEstimatorArrays)
    if stage == STATE:
        _state_modulus(v, values[0], values[1])
        return DONE
    if stage > DONE:
        _forget(v, stage)
        return DONE
    if stage == COMPARE:
        stage = _compare(v, values)
        if stage == UPDATE and v.t.bank != 0.0:
            _update(v)
            stage = LOOK_FOR_SHIFT
    if stage == LOOK_FOR_SHIFT:
        stage = _look_for_shift(v)
    if stage == TRANSFER:
        _transfer(v)
        stage = DONE
    return stage
