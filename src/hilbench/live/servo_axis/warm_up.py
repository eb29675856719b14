"""Warm-up of a diagnosis: its repeated parts run once on a few seconds of made-up samples, to be compiled and
loaded."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from hilbench.bench.reports.diagnosis_updates import CHUNK_CYCLES, Samples
from hilbench.diagnosis.diagnosis import diagnosed
from hilbench.diagnosis.emulated import emulation_of
from hilbench.diagnosis.measured import SHORTEST_S
from hilbench.errors import UnusableInputError
from hilbench.live.servo_axis.machine import LiveShaft
from hilbench.live.session import Session
from hilbench.live.watch import ROW
from hilbench.live.window import Window
from hilbench.plant.servo_axis.emulated_run import ShaftEmulation
from hilbench.topology.config import BenchConfig
from hilbench.topology.live_config import LiveDiagnosisConfig

#: A shaft that swings, rad/s, once in so many s; noise of its torque, N·m.
_MEAN_RAD_S, _SWING_RAD_S, _PERIOD_S, _NOISE_Nm = 20.0, 10.0, 2.0, 0.05


def machine(config: BenchConfig) -> LiveShaft:
    """What a session diagnoses."""
    emulation = emulation_of(config) if config.load_motors else None
    assert emulation is None or isinstance(emulation, ShaftEmulation), "of this machine"
    return LiveShaft(config.servo_axis, emulation, config.cycle_time_s)


def warm_up(names: Sequence[str], machine: LiveShaft, config: LiveDiagnosisConfig, cycle_s: float) -> None:
    """Compile and load a `Session` with these arguments; nothing else is kept."""
    count = round((SHORTEST_S + 0.5) / cycle_s)
    t_s, phase = cycle_s * np.arange(count), 2.0 * np.pi / _PERIOD_S
    speed = _MEAN_RAD_S - _SWING_RAD_S * np.cos(phase * t_s)
    channels = {name: np.zeros(count) for name in names}
    channels["t_s"] += t_s
    channels["x1_rad"] += _MEAN_RAD_S * t_s - _SWING_RAD_S / phase * np.sin(phase * t_s)
    channels["v1_rad_s"] += speed
    channels["v1_cmd_rad_s"] += speed
    channels["tau1_Nm"] += _NOISE_Nm * np.random.default_rng(0).standard_normal(count)
    for name in names:
        if name.startswith("tau_") and name.endswith("_cmd_Nm"):
            channels[name] += 1.0  # a load motor emulates
    for name, value in zip(machine.estimated, machine.estimate_of(machine.configured), strict=True):
        channels[name] += value
    rows = np.column_stack([channels[name] for name in names])
    session = Session(names, machine, config, cycle_s)
    for end in range(CHUNK_CYCLES, (ROW + 1) * CHUNK_CYCLES, CHUNK_CYCLES):
        session.samples(Samples.of(end - 1, rows[end - CHUNK_CYCLES : end]))
    window = Window(names, count, cycle_s)
    window.add(count - 1, Samples.of(count - 1, rows).rows)
    with suppress(UnusableInputError):  # of made-up data nothing has to come
        data = machine.data_of(window, machine.configured, 0, count, 0)
        diagnosed(data, machine.configured, emulation=machine.emulation)
