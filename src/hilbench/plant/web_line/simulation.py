"""Whole recordings in one compiled call: a line, or a rig whose load motors emulate one, or a shaft.

In each cycle of an emulation, as on the bench (`hilbench.bench.tasks.load_model`): the line (`line_follower`) is
followed on the positions of its driven rollers at SYNC, its tension is predicted over the dead time of the emulation,
and the load motor gets the torque with the next SYNC. Between them the axes turn under their drives and the load motor,
without a web. Noise and resolution are left out.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.compiled import (
    COUNT,
    MATRIX,
    TABLE,
    VECTOR,
    Reals,
    Reals2,
    Table,
    Vector,
    Wholes,
    arrays_in,
    entry_point,
    inlined,
    record_type,
)
from hilbench.compiled import records as array_of
from hilbench.plant.web_line import kernel, line_kernel, line_vectors, records, reels
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.line_kernel import HISTORY, ROLLER, FollowedLine
from hilbench.plant.web_line.line_vectors import LineVectors
from hilbench.plant.web_line.records import LineArrays
from hilbench.plant.web_line.shaft_load import ShaftLoad, emulate_shaft

#: A bus cycle, and the dead time from measured motion to the torque of a load motor, s.
TIMES: Final = record_type("cycle_s", "lead_s")


class WebLoad(NamedTuple):
    """Lines of K spans that load motors emulate on rigs of N axes: their parameters (B, P) and states (B, S), inputs,
    scratch space and outputs; history and driven rollers as of a `FollowedLine`.

    `sensors`: rows of which the readings are recorded; `pulls` (N,): N·m at the motor per N; `boundary` (n, 2) upstream
    strain and downstream tension (N). Carriages `pushed`, rows of the line, get `forces` (n, C), each of which acts to
    the next row; `more` (C,): forces beyond these at the start, added by effects. Room for a `guess` of the state; zero
    offsets `further` (N,); `loads` (N,): torques sent next.
    """

    web: Reals2
    states: Reals2
    u: Reals
    w: Reals
    seen: Reals
    history: Annotated[Any, HISTORY]
    rollers: Annotated[Any, array_of(ROLLER)]
    rows: Wholes
    sensors: Wholes
    pulls: Reals
    boundary: Reals2
    pushed: Wholes
    forces: Reals2
    bases: Reals
    more: Reals
    guess: Reals
    further: Reals
    loads: Reals
    times: Annotated[Any, TIMES]


@inlined
def _emulate_web(rig: LineArrays, load: WebLoad, b: int, row: int, out: Vector, at: int) -> None:
    """Cycle of line b on a rig, whose report is in `out` from `at` on; behind it tensions and strains, and sensors."""
    of = FollowedLine(
        LineVectors(load.web[b], load.states[b], load.u, load.w, load.seen), load.history, load.rollers, load.rows
    )
    line, guess, before = line_vectors.arrays(of.line), load.guess, max(row - 1, 0)
    around, times = records.boundary(line), load.times
    if row == 0:
        load.history.known = load.history.duration_s = 0.0
        for i in range(rig.n):
            load.rollers[i].mean_m_s = load.rollers[i].a_m_s2 = load.loads[i] = 0.0
        for j in range(rig.n, rig.m):  # of a line that runs
            load.loads[int(records.motor(rig, j).axis)] = records.drive(rig, j).torque_Nm
        for j in range(len(load.pushed)):
            load.more[j] = records.axis(line, load.pushed[j]).force_N - load.bases[j]
    around.strain_prev, around.F_next_N = load.boundary[before, 0], load.boundary[before, 1]
    if row > 0:
        for j in range(len(load.pushed)):
            records.axis(line, load.pushed[j]).force_N = load.forces[before, j] + load.more[j]
        line_kernel.follow_to(line, of, out[at : at + rig.n], load.further, times.cycle_s)
    # Steps of E are spread over the next cycle, so that what is found is continuous in their times.
    records.web(line).substeps = load.history.sample_s / times.cycle_s
    kernel.observe(*of.line)
    at += kernel.columns(rig)
    for j in range(2 * line.k):
        out[at + j] = load.seen[3 * line.m + j]
    for j in range(len(load.sensors)):
        axis, x = records.axis(line, load.sensors[j]), line.s[lay.S_Y + load.sensors[j]]
        out[at + 2 * line.k + j] = axis.radius_m * reels.radius_ratio(axis, x) if axis.reel_slope_per_m != 0.0 else x
    around.strain_prev, around.F_next_N = load.boundary[row, 0], load.boundary[row, 1]
    ahead = records.line_of(line.p, guess, line.u, line.w)
    line_kernel.predict(line, ahead, of, times.lead_s, times.lead_s)  # only the motion: the tension has the present E
    kernel.observe(line.p, guess, line.u, line.w, load.seen)
    for j in range(rig.n, rig.m):  # the torque for the measurement at the previous SYNC
        records.given(rig, j).setpoint = load.loads[int(records.motor(rig, j).axis)]
    for i in range(rig.n):
        load.loads[i] = line_kernel.web_force_N(line, load.seen, load.rows[i]) * load.pulls[i]


#: simulate(parameters (B, P), states (B, S), inputs, work, commands (n, M), boundary (n, 2), samples, out (B · n · C,),
#: C, tables of a `WebLoad` and of a `ShaftLoad`, empty without): for each row observe, then advance `samples` with the
#: row's set points, upstream strain and downstream tension.
@entry_point(MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, MATRIX, COUNT, VECTOR, COUNT, TABLE, TABLE, allocates=False)
def simulate(
    p: Vector, s: Vector, u: Vector, work: Vector, commands: Vector, boundary: Vector, samples: int, out: Vector,
    columns: int, web: Table, shaft: Table,
) -> None:  # fmt: skip
    at = 0
    for b in range(p.shape[0]):
        line = records.line_of(p[b], s[b], u, work)
        around = records.boundary(line)
        if len(web) > 0:  # once a line, not once a row: it hands out 19 arrays
            load = arrays_in(web, WebLoad)
        kernel.enter(line)
        for row in range(commands.shape[0]):
            around.strain_prev, around.F_next_N = boundary[row, 0], boundary[row, 1]
            for j in range(commands.shape[1]):
                records.given(line, j).setpoint = commands[row, j]
            kernel.report(line, out, at)
            if len(web) > 0:
                _emulate_web(line, load, b, row, out, at)
            elif len(shaft) > 0:
                emulate_shaft(line, arrays_in(shaft, ShaftLoad), b, row, out, at)
            kernel.go_on(line, samples)
            at += columns
        kernel.leave(line)


#: No emulation, for `simulate`.
NOTHING: Final = np.zeros((0, 4), np.int64)
