"""Diagnosis and synchronizers: wall time against the length of a recording."""

from __future__ import annotations

import time

import numpy as np
from tests.simulated_measurements import simulated_measurements
from tests.simulated_recordings import hidden_recording

from hilbench.diagnosis.diagnosis import diagnose
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.web_line_synchronization import compare_methods, methods_of
from performance.table import Section

_METHODS = "ekf,rls,pid"
_HIDDEN = EffectEntry(effect="viscous_friction", axis=2, parameters={"coefficient_N_s_per_m": 3.0})


def diagnosis(model: ModelParameters, lengths_s: list[float]) -> Section:
    """Of recordings with one hidden effect."""
    section = Section(
        "Diagnosis against length of recording",
        "One effect hidden, the whole vocabulary tried; rows of 2 ms, machine code in place.",
    )
    diagnose(hidden_recording(model, [_HIDDEN], duration_s=min(lengths_s), seed=1), model, "warm-up")
    first = 0.0
    for length in lengths_s:
        recording = hidden_recording(model, [_HIDDEN], duration_s=length, seed=2)
        start = time.perf_counter()
        found = diagnose(recording, model, "blind")
        spent = time.perf_counter() - start
        first = first or spent / length
        named = ", ".join(effect.effect for effect in found.effects) or found.verdict
        section.add(f"{length:g} s ({named})", spent, "s", spent / length / first, "per second of the shortest")
    return section


def synchronizers(model: ModelParameters, lengths_s: list[float]) -> Section:
    """Of recordings of the demo's step."""
    section = Section(
        "Synchronizers against length of recording", f"The methods {_METHODS} beside each other on one recording."
    )
    first = 0.0
    for length in [min(lengths_s), *lengths_s]:
        n = round(length / 0.002)
        t = np.arange(n) * 0.002
        speed = 3.0 * np.minimum(t / 4.0, 1.0)
        modulus = np.where(t > 0.5 * length, 1.2, 1.0) * model.youngs_modulus_Pa(1)
        data = simulated_measurements(model, np.column_stack([speed * (1.0 - model.upstream_strain), speed]), modulus)
        start = time.perf_counter()
        compare_methods(model, data, methods_of(_METHODS), modulus, None)
        spent = time.perf_counter() - start
        if first == 0.0:
            first = -1.0  # the first time compiles
            continue
        first = spent / length if first < 0.0 else first
        section.add(f"{length:g} s", spent, "s", spent / length / first, "per second of the shortest")
    return section
