"""Warm-up of a session: its repeated parts run once on a few seconds of made-up samples, to be compiled and loaded."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Final

import numpy as np

from hilbench.bench.reports.diagnosis_updates import CHUNK_CYCLES, Samples
from hilbench.diagnosis.measured import SHORTEST_S
from hilbench.errors import UnusableInputError
from hilbench.live.machine import LiveMachine
from hilbench.live.segment import Segment
from hilbench.live.session import Session
from hilbench.live.watch import ROW
from hilbench.live.window import Window
from hilbench.topology.live_config import LiveDiagnosisConfig

#: Noise of the torques, N·m.
_NOISE_Nm: Final = 0.05
#: What the machine did before the segment that is diagnosed, and that, s.
_BEFORE_S, _STRETCH_S = 2.0, SHORTEST_S + 0.5


def warm_up(names: Sequence[str], machine: LiveMachine, config: LiveDiagnosisConfig, cycle_s: float) -> None:
    """Compile and load a `Session` with these arguments; nothing else is kept."""
    first, count = round(_BEFORE_S / cycle_s), round((_BEFORE_S + _STRETCH_S) / cycle_s)
    noise, t_s = np.random.default_rng(0), cycle_s * np.arange(count)
    speed, steady = machine.steady(CHUNK_CYCLES * cycle_s)
    steady |= dict(zip(machine.estimated, machine.estimate_of(machine.configured).tolist(), strict=True))
    channels = {name: np.full(count, steady.get(name, 0.0)) for name in names}
    channels["t_s"] += t_s
    for name, values in channels.items():
        if name.startswith("x"):
            values += speed * t_s
        elif name.startswith("v"):
            values += speed
        elif name.startswith("tau"):
            values += _NOISE_Nm * noise.standard_normal(count)
    rows = np.column_stack(list(channels.values()))
    session = Session(names, machine, config, cycle_s)
    for end in range(CHUNK_CYCLES, (ROW + 1) * CHUNK_CYCLES, CHUNK_CYCLES):
        session.samples(Samples.of(end - 1, rows[end - CHUNK_CYCLES : end]))
    window = Window(names, count, cycle_s)
    window.add(count - 1, Samples.of(count - 1, rows).rows)
    with suppress(UnusableInputError):  # of made-up data nothing has to come
        segment = Segment.of(machine, window, machine.configured, first, count, 0)
        segment.residual(machine.packed(machine.configured))
