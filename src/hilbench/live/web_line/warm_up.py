"""Warm-up of a diagnosis: its repeated parts run once on a few seconds of made-up samples, to be compiled and
loaded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.reports.diagnosis_updates import CHUNK_CYCLES, Samples
from hilbench.diagnosis.emulated import emulation_of
from hilbench.diagnosis.measured import SHORTEST_S
from hilbench.errors import UnusableInputError
from hilbench.live.segment import Segment
from hilbench.live.session import Session
from hilbench.live.watch import ROW
from hilbench.live.web_line.gap import exchanged_m
from hilbench.live.web_line.machine import LiveLine
from hilbench.live.window import Window
from hilbench.plant.web_line.emulation import Emulation
from hilbench.topology.config import BenchConfig
from hilbench.topology.live_config import LiveDiagnosisConfig

Array = NDArray[np.float64]

#: Noise of its torques, N·m.
_NOISE_Nm = 0.05
#: What the line did before the segment that is diagnosed, and that, s.
_BEFORE_S, _STRETCH_S = 2.0, SHORTEST_S + 0.5


def machine(config: BenchConfig) -> LiveLine:
    """What a session diagnoses."""
    emulation = emulation_of(config) if config.load_motors else None
    assert emulation is None or isinstance(emulation, Emulation), "of this machine"
    return LiveLine(config.web_line, emulation, config.cycle_time_s, config.shape.estimated)


def warm_up(names: Sequence[str], machine: LiveLine, config: LiveDiagnosisConfig, cycle_s: float) -> None:
    """Compile and load a `Session` with these arguments; nothing else is kept."""
    first, count = round(_BEFORE_S / cycle_s), round((_BEFORE_S + _STRETCH_S) / cycle_s)
    noise, model = np.random.default_rng(0), machine.configured
    # All of its web is another one with the second chunk: only then the watch looks at anything.
    speed_m_s = exchanged_m(model) / (CHUNK_CYCLES * cycle_s)
    channels: dict[str, Array] = {name: np.zeros(count) for name in names}
    for name in names:
        if name.startswith("x"):
            channels[name] += speed_m_s * cycle_s * np.arange(count)
        elif name.startswith("v"):
            channels[name] += speed_m_s
        elif name.startswith("tau"):
            channels[name] += _NOISE_Nm * noise.standard_normal(count)
    channels["t_s"] += cycle_s * np.arange(count)
    channels["strain_prev"] += model.upstream_strain
    channels["F_next_N"] += model.boundary.downstream_tension_N
    for name, value in zip(machine.estimated, machine.estimate_of(model), strict=True):
        channels[name] += value
    session = Session(names, machine, config, cycle_s)
    for end in range(CHUNK_CYCLES, (ROW + 1) * CHUNK_CYCLES, CHUNK_CYCLES):
        chunk = np.column_stack([channels[name][end - CHUNK_CYCLES : end] for name in names])
        session.samples(Samples.of(end - 1, chunk))
    with suppress(UnusableInputError):  # of made-up data nothing has to come
        segment = Segment.of(machine, _window(channels, cycle_s), model, first, count, 0)
        segment.residual(machine.packed(model))


def _window(channels: Mapping[str, Array], cycle_s: float) -> Window:
    rows = np.column_stack(list(channels.values()))
    window = Window(list(channels), len(rows), cycle_s)
    window.add(len(rows) - 1, Samples.of(len(rows) - 1, rows).rows)
    return window
