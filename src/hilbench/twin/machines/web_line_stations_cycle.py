"""Compiled cycle of the twin of a line with stations: it follows the measured motion, sums up residuals of torques and
station sensors, simulates and publishes.

It returns the part of a cycle that is Python's: what is done once in a block or window of cycles, or rarely. Called
with that part it goes on behind it. In the table of the arrays those of the load sensitivities, of the line with its
perturbed copies, and of the transient detectors follow.
"""

from __future__ import annotations

from math import inf
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Reals2,
    Wholes,
    arrays_in,
    compiled,
    entry_point,
    record_in,
    record_type,
    rows_of,
)
from hilbench.compiled import records as array_of
from hilbench.estimation import noise_level
from hilbench.estimation.bank import Places
from hilbench.estimation.web_line import transients
from hilbench.estimation.web_line.span_estimator_cycle import DIVERGED_S
from hilbench.estimation.web_line.transients import TransientArrays
from hilbench.plant.motor_port import FEEDBACK_SIZE, LIMITED, TORQUE
from hilbench.plant.sample_coherence import OWN, coherent, own_travels
from hilbench.plant.web_line import drive_response, kernel, line_kernel, line_vectors, rig_cycle
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.drive_response import ResponseArrays
from hilbench.plant.web_line.line_cycle import LOAD
from hilbench.plant.web_line.line_kernel import Copies, FollowedLine
from hilbench.plant.web_line.rig_cycle import RigArrays
from hilbench.plant.web_line.sensitivity_model import SlopesArrays, put_load_slopes
from hilbench.twin.virtual_io import HOLDING, NOT_SEPARABLE, RUNNING, SYNCHRONIZED, TRANSFER_REFUSED

#: Parts that are Python's, in their order: block of the slip detection, or torques that are of no use; a slip begins;
#: transients to decide or to forget; correction; tensions of sections whose encoders are wrong; boundary inputs to be
#: read (a command alone); what is stated with a deviation. Then the ends of a cycle, by its objects and in vectors.
BEGIN, BREAKS, SLIP, TRANSIENTS, CORRECTION, BELIED, LISTEN, STATED = 0, 1, 2, 3, 4, 5, 6, 7
COMPARED, DONE, PROBLEM, WITHOUT = 8, 9, 10, 11

#: Of the twin: time; cycle time, drive samples of a cycle; least travel of the coherence check; flags: axes have speeds
#: of their own, the line is stepped by its object. Cycles without measurement; last position of the last roller, length
#: of web with unknown strain; flags: adaptation is frozen, a torque is limited, what is stated with a deviation is up
#: to date, it is separable; the status of the last SYNC.
TWIN: Final = record_type(
    *("time_s", "cycle_s", "samples", "least_travel_m", "own_travels", "by_object", "missed", "last_m", "unknown_m"),
    *("frozen", "limited", "stated", "separable", "status"),
)
#: A published section: its span, from 0; the axis after it, from 0, if E is stated (else -1), E and deviation. Then a
#: carriage with its row in the integrated quantities (else -1), or a reel with its axis, from 0, and the radius at the
#: start; the deviation. A carriage with a stated force: its place in the parameters, and the force that an effect adds.
OF_SPAN: Final = record_type("span", "axis", "modulus_Pa", "deviation_Pa")
STATION: Final = record_type("row", "axis", "scale", "deviation")
PUSH: Final = record_type("parameter", "more_N")
#: Of the filter: cycles in the window, and its length; travel, in the window, and from which on the web is known; the
#: last position of the last roller; duration of the last motion; flags: the speed before is known, load motors emulate
#: the web, transients are searched, a web slips; what is known of uncertain transients has changed.
FILTER: Final = record_type(
    *("count", "window", "travel_m", "window_travel_m", "known_from_m", "followed_m", "followed_s"),
    *("has_speeds", "emulated", "searches", "slips", "uncertain"),
)
#: Of a station's sensor: scale of its reading; carriage's row in the integrated quantities, first span of a load cell,
#: axis of a reel and its unknown, all from 0 and -1 for others.
SENSOR: Final = record_type("scale", "carriage", "cell", "axis", "own")
#: Of the detection of breaks: time; cycles in the block, and place of the latest; by the last block: doubt about the
#: torques, latest time without slip, whether there is a problem, and whether tensions are belied; whether it rests.
WATCH: Final = record_type("time_s", "count", "last", "doubtful", "since_s", "problem", "belied", "suspended")
#: Places in the integers of SYNC number and status.
AT: Final = record_type("number", "status", of=np.int64)
_MEASURED_SIZE = 4
_NUMBERS = 0x10000


class FilterArrays(NamedTuple):
    """Of the filter of n unknowns: axes with usable torques, from 0 (m,), their innovations, states of their noise, its
    variances, least ones in which transients are searched, and those; sums of innovations and their sensitivities over
    a window (m + s, n); sensors (s,) and their innovations; which unknowns torques show (n,), perturbations and errors
    (n,); of the driven rollers lacking flywheel, rad per m at the motor, and speed (N,); the drives' response to the
    loads (N, n + 1)."""

    state: Annotated[Any, FILTER]
    rows: Wholes
    left_Nm: Reals
    noise: Reals2
    variances_Nm2: Reals
    least_Nm2: Reals
    searched_Nm2: Reals
    sums: Reals
    slopes: Reals2
    sensors: Annotated[Any, array_of(SENSOR)]
    sensed: Reals
    shows: Reals
    steps: Reals
    errors: Reals
    lacking_kg_m2: Reals
    rad_per_m: Reals
    speeds_rad_s: Reals
    response: ResponseArrays
    loads: Reals2


class WatchArrays(NamedTuple):
    """Of the detection of breaks: loads of the web at the motors (N,); of each cycle of a block positions and torques
    with those loads (C, N), tensions (C, K), and errors of the unknowns (C, n)."""

    state: Annotated[Any, WATCH]
    loads: Annotated[Any, array_of(LOAD)]
    positions_m: Reals2
    torques_Nm: Reals2
    tensions_N: Reals2
    errors: Reals2


class StationsArrays(NamedTuple):
    """The line with its twin; `measured`, `values`, `whole` as of `MachineVectors`; `inputs`: places in
    the values of strain upstream and tension downstream, sensors, and forces on carriages; `handed_on`: integrated
    quantities that the line takes over from that on measured motion."""

    twin: Annotated[Any, TWIN]
    travels: Reals  #: state of the coherence check
    m_per_rad: Reals  #: of the motors, at the web
    positions_m: Reals
    torques_Nm: Reals
    residuals_Nm: Reals
    measured: Reals
    rig: RigArrays
    silence: Reals
    values: Reals
    whole: Wholes
    at: Annotated[Any, AT]
    inputs: Wholes
    published: Wholes
    spans: Annotated[Any, array_of(OF_SPAN)]
    stations: Annotated[Any, array_of(STATION)]
    pushes: Annotated[Any, array_of(PUSH)]
    filter: FilterArrays
    watch: WatchArrays
    handed_on: Wholes


_SLOPES: Final = rows_of(StationsArrays)
_COPIES: Final = _SLOPES + rows_of(SlopesArrays)
_FIRST, _EACH = _COPIES + rows_of(Copies), rows_of(FollowedLine)


@compiled
def _follow(a: StationsArrays, table: Places) -> bool:
    """Move the line and its copies by the measured positions; False if these are not coherent (of one instant)."""
    x_m, twin, f, elapsed = a.positions_m, a.twin, a.filter.state, a.twin.missed + 1.0
    for k in range(len(x_m)):
        x_m[k] = a.measured[_MEASURED_SIZE * k] * a.m_per_rad[k]
        a.torques_Nm[k] = a.measured[_MEASURED_SIZE * k + TORQUE]
    if twin.own_travels == 0.0:
        usable = coherent(a.travels, x_m, twin.least_travel_m)
    else:
        usable = own_travels(a.travels, x_m)
        elapsed = record_in(a.travels, 0, OWN).elapsed
    if not usable or elapsed == 0.0:
        return False
    copies, answered = arrays_in(table[_COPIES:], Copies), a.filter.response.torques
    for k in range(len(x_m)):
        simulated_Nm = a.rig.shown[FEEDBACK_SIZE * k + TORQUE]
        a.residuals_Nm[k] = a.torques_Nm[k] - simulated_Nm - answered[k, answered.shape[1] - 1]
        copies.x[k] = x_m[k]
    if twin.missed == 0.0:
        _sense(a, copies)
    for each in range(len(copies.offsets)):
        u = arrays_in(table[_FIRST + each * _EACH :], FollowedLine).line.u
        u[0], u[1] = a.values[a.inputs[0]], a.values[a.inputs[1]]
    f.followed_s = elapsed * twin.cycle_s
    line_kernel.follow(f.followed_s, 0, len(copies.offsets), table[_COPIES:])
    now_m = x_m[len(x_m) - 1]
    travel_m, before_m = abs(now_m - f.followed_m), f.travel_m
    f.travel_m, f.window_travel_m, f.followed_m = before_m + travel_m, f.window_travel_m + travel_m, now_m
    if before_m < f.known_from_m <= f.travel_m:
        twin.stated = 0.0
    twin.unknown_m, twin.last_m = max(twin.unknown_m - abs(now_m - twin.last_m), 0.0), now_m
    twin.missed = 0.0
    return True


@compiled
def _sense(a: StationsArrays, copies: Copies) -> None:
    """Take the readings of the station sensors for the last motion."""
    v, motions, tensions, first = a.filter, copies.motions, copies.tensions, len(a.filter.rows)
    for s in range(len(v.sensors)):
        sensor = v.sensors[s]
        row, cell = int(sensor.carriage), int(sensor.cell)
        left = v.sensed[s] = a.values[a.inputs[2 + s]] / sensor.scale
        if row >= 0:
            left -= motions[0, row]
        elif cell >= 0:
            left -= 0.5 * tensions[0, cell] + 0.5 * tensions[0, cell + 1]
        else:
            left -= copies.ratios[int(sensor.axis)]
            v.slopes[first + s, int(sensor.own)] += 1.0
        v.sums[first + s] += left
        for i in range(len(v.steps)):
            more = 0.0
            if row >= 0:
                more = motions[1 + i, row] - motions[0, row]
            elif cell >= 0:
                more = 0.5 * tensions[1 + i, cell] + 0.5 * tensions[1 + i, cell + 1]
                more -= 0.5 * tensions[0, cell] + 0.5 * tensions[0, cell + 1]
            v.slopes[first + s, i] += more / v.steps[i]


@compiled
def _look_for_breaks(a: StationsArrays, first: FollowedLine, tensions_N: Reals) -> bool:
    """Take the cycle for the detection of web break, slip and slack; True if Python's part follows."""
    v, w, twin, line, shown = a.watch, a.watch.state, a.twin, line_vectors.arrays(first.line), a.rig.shown
    twin.limited, at, out = 0.0, int(w.count), first.line.out
    for k in range(len(a.positions_m)):
        twin.limited = max(twin.limited, shown[FEEDBACK_SIZE * k + LIMITED])
    if twin.limited != 0.0 or twin.frozen != 0.0:
        w.count = 0.0
        return bool(w.suspended == 0.0)
    w.suspended, w.last, w.count = 0.0, w.count, w.count + 1.0
    w.time_s += twin.cycle_s
    for j in range(len(tensions_N)):
        v.tensions_N[at, j] = tensions_N[j]
    for i in range(len(a.filter.errors)):
        v.errors[at, i] = a.filter.errors[i]
    for k in range(len(a.positions_m)):
        row, load = first.rows[k], v.loads[k]
        pull_Nm = line_kernel.web_torque_Nm(line, out, row, load.loaded != 0.0, load.rad_per_m, out[line.m + row])
        v.positions_m[at, k], v.torques_Nm[at, k] = a.positions_m[k], a.torques_Nm[k] + pull_Nm
    return bool(w.count >= len(v.positions_m))


@compiled
def _innovate(a: StationsArrays, table: Places, copies: int) -> bool:
    """Innovations of the torques; True if there are transients to decide, or to forget."""
    v, f, attention = a.filter, a.filter.state, False
    for i in range(len(v.rows)):
        v.left_Nm[i] = a.residuals_Nm[v.rows[i]]
        noise_level.take(v.noise[i], v.left_Nm[i])
        v.variances_Nm2[i] = noise_level.variance(v.noise[i])
        v.searched_Nm2[i] = v.least_Nm2[i] + v.variances_Nm2[i]
    if a.twin.limited != 0.0 or a.watch.state.doubtful != 0.0 or a.twin.frozen != 0.0:
        return False
    for at in range(_FIRST + copies * _EACH, len(table), transients.ROWS):
        d = arrays_in(table[at:], TransientArrays)
        if f.searches != 0.0 and f.slips == 0.0:
            attention |= transients.take(d, v.left_Nm, v.searched_Nm2)
        else:
            attention |= d.state.filled != 0.0
    return bool(attention or f.uncertain != 0.0)


@compiled
def _add_up(a: StationsArrays, table: Places, first: FollowedLine) -> bool:
    """Add the torques' innovations and sensitivities to the window, update the load sensitivities; True at its end."""
    v, f, line = a.filter, a.filter.state, first.line
    answered, count = v.response.torques, line_vectors.arrays(line).m
    for i in range(len(v.rows)):
        v.sums[i] += v.left_Nm[i]
        for j in range(len(v.shows)):
            v.slopes[i, j] += answered[v.rows[i], j] * v.shows[j]
    f.count += 1.0
    put_load_slopes(0, table[_SLOPES:])
    for k in range(len(v.speeds_rad_s)):
        speed = v.rad_per_m[k] * line.out[count + first.rows[k]]
        if f.emulated != 0.0 and f.has_speeds != 0.0:
            # A load motor emulates the tension of a reel, but with the flywheel that this had at the start.
            v.loads[k, len(v.shows)] += v.lacking_kg_m2[k] * (speed - v.speeds_rad_s[k]) / f.followed_s
        v.speeds_rad_s[k] = speed
    f.has_speeds = 1.0
    return bool(f.count >= f.window)


@compiled
def _publish(a: StationsArrays, copies: Copies) -> int:
    """Tension of each section; where E is stated also E with its deviation (inf if not identified), the simulated
    torque of the axis after it, and the residual; position of each carriage, radius of each reel, with their
    deviations. Returns the status of `TwinApplication` for a released machine with its configured model."""
    values, at, place, w = a.values, a.published, 0, a.watch.state
    missing_Nm, status = a.filter.response.torques, RUNNING
    for span in a.spans:
        values[at[place]] = line_vectors.tension_N(a.rig.line, int(span.span))
        place += 1
        axis = int(span.axis)
        if axis >= 0:
            values[at[place]], values[at[place + 1]] = span.modulus_Pa, span.deviation_Pa
            shown_Nm = a.rig.shown[FEEDBACK_SIZE * axis + TORQUE]
            values[at[place + 2]] = shown_Nm + missing_Nm[axis, missing_Nm.shape[1] - 1]
            values[at[place + 3]] = a.residuals_Nm[axis]
            place += 4
    for station in a.stations:
        row = int(station.row)
        found = copies.motions[0, row] if row >= 0 else copies.ratios[int(station.axis)]
        values[at[place]], values[at[place + 1]] = station.scale * found, station.deviation
        place += 2
    if a.twin.missed * a.twin.cycle_s > DIVERGED_S:
        status |= TRANSFER_REFUSED
    elif a.twin.unknown_m == 0.0:
        status |= SYNCHRONIZED
    if w.problem != 0.0:
        status |= HOLDING
    return status if a.twin.separable != 0.0 else status | NOT_SEPARABLE


@entry_point(COUNT, TABLE)
def run(done: int, table: Places) -> int:
    """Run a cycle from behind a part (0: all of it) to the next one that is Python's, or to its end."""
    a = arrays_in(table, StationsArrays)
    copies, first = arrays_in(table[_COPIES:], Copies), arrays_in(table[_FIRST:], FollowedLine)
    twin, line, count, usable = a.twin, a.rig.line, len(copies.offsets), True
    if done == BEGIN:
        usable = _follow(a, table)
        if usable and _look_for_breaks(a, first, copies.tensions[0]):
            return BREAKS
    if not usable:
        twin.missed += 1.0
        a.watch.state.count = 0.0
    if usable and done <= BREAKS:
        slips, slipped = a.watch.state.since_s < inf, a.filter.state.slips != 0.0
        a.filter.state.slips = 1.0 if slips else 0.0
        if slips and not slipped:
            return SLIP
        if _innovate(a, table, count):
            return TRANSIENTS
    if usable and done <= TRANSIENTS and _add_up(a, table, first):
        return CORRECTION
    if usable and done <= CORRECTION:
        r = a.filter.response
        drive_response.answer(r.states, r.transition, r.inputs, r.gains, r.torques, a.filter.loads, True)
        if a.watch.state.belied != 0.0:
            return BELIED
    if usable and done <= BELIED:
        for at in a.handed_on:
            line.s[lay.S_Y + at] = first.line.s[lay.S_Y + at]
        kernel.set_modes(line_vectors.arrays(line))
        kernel.observe(*line)
    if done <= BELIED and twin.by_object != 0.0:
        twin.time_s += twin.cycle_s
        return COMPARED if usable else WITHOUT
    if done <= LISTEN:
        line.u[0], line.u[1] = a.values[a.inputs[0]], a.values[a.inputs[1]]
        for k in range(len(a.pushes)):
            parameter, more_N = int(a.pushes[k].parameter), a.pushes[k].more_N
            line.p[parameter] = force_N = a.values[a.inputs[2 + len(a.filter.sensors) + k]] + more_N
            for each in range(count):  # from the next cycle on
                arrays_in(table[_FIRST + each * _EACH :], FollowedLine).line.p[parameter] = force_N
        if twin.by_object != 0.0:
            return COMPARED
        rig_cycle.step(a.rig, int(twin.samples), a.silence)
        twin.time_s += twin.cycle_s
        if twin.stated == 0.0:
            return STATED
    status = _publish(a, copies)
    twin.status, a.whole[a.at.status] = a.whole[a.at.status], status
    a.whole[a.at.number] = (a.whole[a.at.number] + 1) % _NUMBERS
    if twin.missed != 0.0:
        return WITHOUT
    return PROBLEM if status & HOLDING else DONE
