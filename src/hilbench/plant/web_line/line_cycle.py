"""Compiled cycle of a line emulated by load motors: time to follow, the line there, load torques of the predicted line,
and true values."""

from __future__ import annotations

from typing import Annotated, Any, Final, NamedTuple

from hilbench.compiled import COUNT, TABLE, Reals, Table, Wholes, arrays_in, compiled, entry_point, record_type
from hilbench.compiled import records as array_of
from hilbench.plant.measured_motion import MotionVectors, ahead_s, elapsed_s, publish, take
from hilbench.plant.web_line import kernel, line_kernel, line_vectors, records, reels
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.line_kernel import FollowedLine

#: A load motor: its driven roller, from 0, and rad per m at its shaft; whether the web loads it.
LOAD: Final = record_type("roller", "rad_per_m", "loaded")


class LoadedLine(NamedTuple):
    """Line with load motors (L,): speeds of the driven rollers (N,) m/s; room for a state, and for its outputs; torques
    (L,) N·m, by the line `lead_s` (1,) later; E of the spans (K,) Pa."""

    of: FollowedLine
    loads: Annotated[Any, array_of(LOAD)]
    speeds: Reals
    guess: Reals
    ahead: Reals
    torques: Reals
    lead_s: Reals
    moduli: Reals


class LineCycle(NamedTuple):
    """Loaded line on measured motion: zero position offsets (N,); indices of the outputs in the kernel's report and in
    the integrated quantities, and rows of the reels; room for all outputs; the process image's values and the offsets
    in it."""

    loaded: LoadedLine
    motion: MotionVectors
    further: Reals
    columns: Wholes
    states: Wholes
    reels: Wholes
    shown: Reals
    values: Reals
    at: Wholes


#: What `follow` does: a cycle with a sample that is on time, or late; load torques and E only.
ON_TIME, LATE, PULL = 0, 1, 2
#: Results of `follow`.
NOTHING, FOLLOWED = 0, 1


@compiled
def _pull(loaded: LoadedLine, lead_s: float) -> None:
    """Load torques, by the line predicted `lead_s` ahead at its driven rollers' present motion; and E of its spans."""
    of, guess = loaded.of, loaded.guess
    line = line_vectors.arrays(of.line)
    ahead = records.line_of(line.p, guess, line.u, line.w)
    line_kernel.predict(line, ahead, of, lead_s, 0.0)
    kernel.observe(line.p, guess, line.u, line.w, loaded.ahead)
    for j in range(len(loaded.torques)):
        load, i = loaded.loads[j], int(loaded.loads[j].roller)
        loaded.torques[j] = line_kernel.web_torque_Nm(
            line, loaded.ahead, of.rows[i], load.loaded != 0.0, load.rad_per_m, loaded.speeds[i]
        )
    line_kernel.put_moduli(line, loaded.moduli, 0)


#: follow(what, table of a `LineCycle`, or, only to pull, a `LoadedLine`): as of `measured_motion.InStep`.
@entry_point(COUNT, TABLE, allocates=False)
def follow(what: int, table: Table) -> int:
    if len(table) == 0:
        return NOTHING
    if what == PULL:
        loaded = arrays_in(table, LoadedLine)
        _pull(loaded, loaded.lead_s[0])
        return FOLLOWED
    cycle = arrays_in(table, LineCycle)
    loaded, motion, values, at = cycle.loaded, cycle.motion, cycle.values, cycle.at
    take(values, at, motion.positions, loaded.speeds)
    duration_s = elapsed_s(motion.state, motion.travels, motion.positions, loaded.speeds, what == LATE)
    if not duration_s > 0.0:
        return NOTHING
    line = line_vectors.arrays(loaded.of.line)
    line_kernel.follow_to(line, loaded.of, motion.positions, cycle.further, duration_s)
    kernel.observe(*loaded.of.line)
    _pull(loaded, ahead_s(motion.state))
    shown, place = cycle.shown, 0
    for column in cycle.columns:
        shown[place] = loaded.of.line.out[column]
        place += 1
    for state in cycle.states:
        shown[place] = line.s[lay.S_Y + state]
        place += 1
    for row in cycle.reels:
        axis = records.axis(line, row)
        shown[place] = axis.radius_m * reels.radius_ratio(axis, line.s[lay.S_Y + row])
        place += 1
    for modulus_Pa in loaded.moduli:
        shown[place] = modulus_Pa
        place += 1
    publish(values, at[2 * len(motion.positions) :], loaded.torques, cycle.shown)
    return FOLLOWED
