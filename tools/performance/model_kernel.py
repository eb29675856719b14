"""The model kernel beside scipy and plain Python; what effects, spans and many variants cost."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.simulated_recordings import PERIOD_S, experiment

from hilbench.plant.parameters import EffectEntry
from hilbench.plant.sampling import samples_per
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import simulation
from hilbench.plant.web_line.offline import simulate, start_state
from hilbench.plant.web_line.parameters import ModelParameters
from performance.plain_equations import PlainLine
from performance.table import Section, best_cpu_s, best_s

_DURATION_S = 24.0
_TIMES = 15
_PLAIN_STEPS, _SCIPY_STEPS = 4000, 400
_SPANS = (1, 2, 5, 10, 20, 50, 100)
_VARIANTS = 64
#: Tension by which kernel and plain equations may differ, N: a mistake in either would be far above it.
_SAME_N = 1e-3

FRICTION: list[dict[str, Any]] = [{"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": 4.0}}]
WAVES: list[dict[str, Any]] = [
    {"effect": "torque_ripple", "axis": 2, "parameters": {"amplitude_Nm": 0.1, "order": 2.0}},
    {"effect": "roller_eccentricity", "axis": 1, "parameters": {"amplitude_m": 2e-5}},
    {"effect": "upstream_disturbance", "parameters": {"amplitude_N": 2.0, "frequency_Hz": 0.8}},
]
SMOOTH: list[dict[str, Any]] = [
    {"effect": "viscous_friction", "axis": 1, "parameters": {"coefficient_N_s_per_m": 2.0}},
    {"effect": "stribeck_friction", "axis": 2, "parameters": {"force_N": 3.0, "speed_m_s": 0.2}},
    {"effect": "friction_asymmetry", "axis": 2, "parameters": {"viscous_difference_N_s_per_m": 1.0}},
    {"effect": "torque_offset", "axis": 2, "parameters": {"offset_Nm": 0.05}},
    {"effect": "torque_scale", "axis": 2, "parameters": {"relative_change": 0.05}},
    {"effect": "torque_delay", "axis": 2, "parameters": {"delay_s": 0.004}},
    {"effect": "inertia_mismatch", "axis": 2, "parameters": {"relative_change": 0.1}},
    {"effect": "elasticity_shift", "parameters": {"relative_change": 0.1}},
    {"effect": "elasticity_step", "parameters": {"time_s": 5.0, "relative_change": 0.1}},
    {"effect": "elasticity_drift", "parameters": {"rate_per_s": 1e-3}},
    {"effect": "strain_offset", "parameters": {"strain": 2e-5}},
    {"effect": "span_length_error", "parameters": {"relative_change": 0.05}},
]
COUPLED: list[dict[str, Any]] = [
    {"effect": "web_damping", "parameters": {"time_constant_s": 0.005}},
    {"effect": "web_slip", "parameters": {"creep_per_N": 2e-6}},
]
PLAY: list[dict[str, Any]] = [{"effect": "backlash", "axis": 2, "parameters": {"gap_rad": 0.01}}]


def with_effects(model: ModelParameters, entries: list[dict[str, Any]]) -> ModelParameters:
    """The model with these effects alone."""
    return model.model_copy(update={"effects": tuple(EffectEntry.model_validate(entry) for entry in entries)})


def line_of(model: ModelParameters, spans: int) -> ModelParameters:
    """The model's span so many times."""
    length = model.span_length_m(1)
    web = model.required_web.model_copy(update={"span_length_m": [length] * spans})
    rollers = model.rollers.model_copy(update={"radius_m": [model.radius_m(1)] * (spans + 1)})
    data = model.model_dump() | {"web": web.model_dump(), "rollers": rollers.model_dump(), "web_load": True}
    return ModelParameters.model_validate(data)


def _recording(model: ModelParameters) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Commands (n, N) and boundary of an experiment; every axis of a line as axis 2 of a single span."""
    e = experiment(model, _DURATION_S, 1)
    commands = np.repeat(e.commands_m_s[:, 1:2], model.axis_count, axis=1)
    commands[:, 0] = e.commands_m_s[:, 0]
    boundary = np.tile([model.upstream_strain, model.boundary.downstream_tension_N], (len(commands), 1))
    return np.ascontiguousarray(commands), boundary


def ns_per_step(model: ModelParameters) -> float:
    """Kernel time per 1 ms step of a whole recording, rows of 2 ms read out."""
    commands, boundary = _recording(model)
    p = lay.pack(model)
    state = start_state(p, model)
    steps = len(commands) * samples_per(PERIOD_S, float(p[lay.W_SAMPLE_TIME_S]))
    return best_cpu_s(lambda: simulate(p, state, commands, boundary, PERIOD_S), _TIMES) / steps * 1e9


def measure(model: ModelParameters) -> list[Section]:
    """All of it, on the one-span model of the demo."""
    plain = with_effects(model, [])
    return [_beside_others(plain), _effects(plain), _spans(plain), _variants(plain)]


def _beside_others(model: ModelParameters) -> Section:
    section = Section(
        "Model kernel, one span",
        f"A 1 ms step of drives, rollers and web: {_DURATION_S:g} s of an experiment in one call, a row every 2 ms, "
        "one core. The same equations in plain Python take the same Runge-Kutta step; scipy's `solve_ivp` (RK45) "
        "integrates them from sample to sample. All three end at the same tension.",
    )
    ours = ns_per_step(model)
    commands, boundary = _recording(model)
    wanted = [[float(v) for v in row] for row in np.repeat(commands, 2, axis=0)]
    p = lay.pack(model)
    tension = simulate(p, start_state(p, model), commands, boundary, PERIOD_S).F_N[:, 0]
    section.add("kernel", ours, "ns")
    section.add("kernel, times real time", 1e6 / ours, "×")
    start = int(np.argmax(np.abs(commands[:, 1]) > 0.0))
    assert 2 * start < _PLAIN_STEPS // 2, "the experiment moves within what is compared"
    for name, count, step in (
        ("plain Python", _PLAIN_STEPS, PlainLine.step),
        ("scipy solve_ivp", 2 * start + _SCIPY_STEPS, PlainLine.step_with_scipy),
    ):
        line = PlainLine(model)

        def run(line: PlainLine = line, count: int = count, step: Any = step) -> None:
            for setpoints in wanted[:count]:
                step(line, setpoints)

        spent_ns = best_cpu_s(run, 1) / count * 1e9
        assert abs(line.tension_N - tension[count // 2]) < _SAME_N, f"{name} and the kernel do not agree"
        section.add(name, spent_ns, "ns", spent_ns / ours, "kernel")
    return section


def _effects(model: ModelParameters) -> Section:
    section = Section(
        "Model kernel, effects",
        "The same recording with effects on. With gear play every step looks for flanks; with dry friction only those "
        "at standstill and around a reversal do.",
    )
    base = ns_per_step(model)
    for name, entries in (
        ("no effect", []),
        ("Coulomb friction", FRICTION),
        ("ripple, eccentricity, disturbance", WAVES),
        ("damping and creep", COUPLED),
        ("gear play", PLAY),
        ("all effects but gear play", [*FRICTION, *WAVES, *SMOOTH, *COUPLED]),
        ("all effects", [*FRICTION, *WAVES, *SMOOTH, *COUPLED, *PLAY]),
    ):
        spent = ns_per_step(with_effects(model, entries))
        section.add(name, spent, "ns", spent / base, "no effect")
    return section


def _spans(model: ModelParameters) -> Section:
    section = Section(
        "Model kernel, spans", "Per step and span of a line of equal spans, each with its roller and drive."
    )
    first = 0.0
    for spans in _SPANS:
        spent = ns_per_step(line_of(model, spans)) / spans
        first = spent if spans == _SPANS[1] else first  # a single span has a path of its own
        section.add(
            f"{spans} spans" if spans > 1 else "1 span",
            spent,
            "ns",
            spent / first if first else None,
            f"{_SPANS[1]} spans",
        )
    return section


def _variants(model: ModelParameters) -> Section:
    section = Section(
        "Model kernel, variants in one call",
        f"{_VARIANTS} parameter sets on the same recording, shared out among the cores.",
    )
    commands, boundary = _recording(model)
    p = lay.pack(model)
    many = np.tile(p, (_VARIANTS, 1))
    many[:, lay.Layout.of(p).first_span + lay.column(lay.SPAN, "modulus_Pa")] *= np.linspace(0.9, 1.1, _VARIANTS)
    state = start_state(p, model)
    layout = lay.Layout.of(p)

    def one_core() -> None:
        states = np.tile(state, (_VARIANTS, 1))
        inputs = layout.new_inputs()
        layout.motor_inputs(inputs).mode = 2.0
        out = np.empty((_VARIANTS, len(commands), layout.output_size))
        rows = commands * layout.motor_rows(p).rad_per_m
        simulation.simulate(
            *(many, states, inputs, layout.new_work(), rows, boundary, 2, out.reshape(-1), out.shape[2]),
            *(simulation.NOTHING, simulation.NOTHING),
        )

    alone = best_s(one_core, 10)
    together = best_s(lambda: simulate(many, state, commands, boundary, PERIOD_S), 10)
    section.add("one core", alone * 1e3, "ms")
    section.add("all cores", together * 1e3, "ms", alone / together, "as fast")
    return section
