"""Stretches of a bench that is late: what that does to the axes is not taken for something that the model lacks."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.machines import emulation_of
from hilbench.diagnosis.predictor import deviations_of
from hilbench.live.machine import Segment
from hilbench.live.web_line import LiveLine
from hilbench.live.window import Window
from hilbench.plant.web_line.emulation import Emulation, simulate_emulated
from hilbench.plant.web_line.layout import pack
from hilbench.plant.web_line.offline import start_state
from hilbench.runs.config import load_with_overrides

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

CONFIG = load_with_overrides(Path(__file__).resolve().parents[2] / "bench_configs" / "live_friction.yaml").config
MODEL, CYCLE_S = CONFIG.web_line, CONFIG.cycle_time_s
TORQUE_NOISE_Nm, POSITION_NOISE_M = 0.05, 1e-7
#: The line is up to speed after the first; from the second to the third is what is looked at, with a ramp in it, s.
RUNS_S, FIRST_S, END_S = 3.0, 12.0, 20.0
RAMP_S = (14.0, 15.0)


@cache
def emulation() -> Emulation:
    found = emulation_of(CONFIG)
    assert isinstance(found, Emulation)
    return found


def commands() -> Array:
    """(n, 2): up to 3 m/s, and down to 2 m/s in the ramp."""
    t_s = np.arange(round(END_S / CYCLE_S)) * CYCLE_S
    speed = np.interp(t_s, [0.0, RUNS_S, *RAMP_S], [0.0, 3.0, 3.0, 2.0])
    return np.column_stack([speed, speed])


def segment(taken: Array, F_next_N: Array, late: Rows) -> Segment:
    """Of a line that takes these commands (n, 2) beside this tension (n,), while nobody knows of either; `late` (n,):
    SYNCs whose answers came late."""
    told, noise = commands(), np.random.default_rng(4)
    boundary = np.column_stack([np.full(len(told), MODEL.upstream_strain), F_next_N])
    p = pack(MODEL)
    run = simulate_emulated(emulation(), MODEL, p, taken, boundary, state=start_state(p, MODEL))
    nominal_N = MODEL.boundary.downstream_tension_N
    channels = {"t_s": np.arange(len(told)) * CYCLE_S, "strain_prev": boundary[:, 0]}
    channels |= {
        "F_next_N": np.full(len(told), nominal_N),
        "tau_load_cmd_Nm": np.ones(len(told)),
        "F_sim_N": run.F_N[:, 0],
    }
    for k in (1, 2):
        channels[f"v{k}_cmd_m_s"] = told[:, k - 1]
        channels[f"x{k}_m"] = run.x_m[:, k - 1] + POSITION_NOISE_M * noise.standard_normal(len(told))
        channels[f"v{k}_m_s"] = run.v_m_s[:, k - 1]
        channels[f"tau{k}_Nm"] = run.tau_Nm[:, k - 1] + TORQUE_NOISE_Nm * noise.standard_normal(len(told))
    window = Window(list(channels), len(told), CYCLE_S)
    rows = np.column_stack([*channels.values(), np.arange(len(told)), late])
    window.add(len(told) - 1, rows.tobytes())
    return Segment.of(LiveLine(MODEL, emulation(), CYCLE_S), window, MODEL, round(FIRST_S / CYCLE_S), len(told), 0)


def left_by_the_right_model(found: Segment) -> dict[str, float]:
    """Mean square of what it leaves, by signal, in units of what a right model leaves."""
    scaled = found.residual(MODEL) / deviations_of(found.predictor)[:, None]
    means = np.mean(scaled[:, found.predictor.rows] ** 2, axis=1)
    return dict(zip(found.predictor.names, means.tolist(), strict=True))


def test_commands_that_are_taken_a_cycle_late_put_off_the_way_and_nothing_else() -> None:
    told = commands()
    in_ramp = (np.arange(len(told)) * CYCLE_S > RAMP_S[0]) & (np.arange(len(told)) * CYCLE_S < RAMP_S[1])
    late = in_ramp & (np.random.default_rng(1).random(len(told)) < 0.1)
    taken = told.copy()
    behind = np.flatnonzero(late) + 1
    taken[behind] = told[behind - 1]
    calm_N = np.full(len(told), MODEL.boundary.downstream_tension_N)
    left = left_by_the_right_model(segment(taken, calm_N, late))
    assert max(left.values()) < 1.2, left
    unknown = left_by_the_right_model(segment(taken, calm_N, np.zeros_like(late)))
    assert max(unknown.values()) > 10.0, "without late answers nothing excuses it"


def test_what_has_pushed_the_rollers_while_the_bench_was_not_heard_is_followed_on() -> None:
    told = commands()
    F_next_N = np.full(len(told), MODEL.boundary.downstream_tension_N)
    late = np.zeros(len(told), bool)
    push = round(17.0 / CYCLE_S)
    F_next_N[push : push + 10] += 60.0
    late[push - 4 : push] = True
    found = segment(told, F_next_N, late)
    assert len(found.data.pushed) == 1
    assert abs(found.data.pushed[0] + round(FIRST_S / CYCLE_S) - push) < 20
    left = left_by_the_right_model(found)
    assert max(left.values()) < 1.2, left
