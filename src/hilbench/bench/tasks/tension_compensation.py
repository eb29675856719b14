"""Compensation of eccentric rollers and torque ripple as a task: a cycle of
`hilbench.control.web_line.compensation`, and what is learned after each turn."""

from __future__ import annotations

from itertools import product
from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.bench.state import Reports
from hilbench.bench.tasks import tension_cycle as cycle
from hilbench.bench.tasks.task import CompiledStages, Outputs, StagedTask
from hilbench.bench.tasks.tension_loop import OperatingPoint, TensionLoop
from hilbench.bench.tasks.tension_task import TensionTask
from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Reals2,
    Reals3,
    Vector,
    Wholes,
    Wholes2,
    arrays_in,
    entry_point,
    interpreted,
    load,
    records,
)
from hilbench.control.web_line import compensation as law
from hilbench.control.web_line.compensation import SPEEDS, Compensated, Complexes
from hilbench.control.web_line.feed_forward import ROLLER, rollers_of
from hilbench.cycle_program import CONTINUE, CompiledStage
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample
from hilbench.topology.web_line_config import Compensable, CompensationConfig

#: Angle of an order in a cycle up to which the loops' response to a command is that of the model.
_FASTEST_RAD = 1.0
#: Relative difference of the radii of rollers up to which both have the same turns.
_ONE_RADIUS = 0.01
#: Effects that turn: of two at one order the first is compensated.
_BY_ANGLE: tuple[Compensable, ...] = ("roller_eccentricity", "torque_ripple")
_TOLD = {
    "helps": "compensated",
    "wrong": "taken back, and learned from nothing: it is not what the model knows",
    "worse": "taken back: it makes it worse",
    "useless": "taken back for good: it does not help",
}
_TURNED = CONTINUE + 1
_GRID_M_S = np.geomspace(law.LEAST_M_S, law.MOST_M_S, SPEEDS)
_begin_turn = interpreted(law.begin_turn)


class _Arrays(NamedTuple):
    """What a cycle works on; `at`: places of positions and speeds at the ends of the span, and of the command; of the
    rollers behind it the places of torque and speed, force per torque and mass."""

    turn: Annotated[Any, law.TURN]
    orders: Annotated[Any, records(law.ORDER)]
    commands: Reals3
    loop: Annotated[Any, cycle.LOOP]
    at: Wholes
    behind_at: Wholes2
    behind: Reals2
    leader: Annotated[Any, cycle.SPEEDS]
    rollers: Annotated[Any, records(ROLLER)]
    frictions_N: Reals2
    values: Reals


@entry_point(COUNT, TABLE)
def run(_: int, table: Wholes2) -> int:
    """Add the correction to the command before the span; `_TURNED` at the end of a turn."""
    a = arrays_in(table, _Arrays)
    values, at, turn = a.values, a.at, a.turn
    x1_m, x2_m, v1_m_s, v2_m_s = values[at[0]], values[at[1]], values[at[2]], values[at[3]]
    angle_rad, force_N, momentum_Ns = x1_m / turn.radius_m, 0.0, 0.0
    values[at[4]] += law.friction_lead_m_s(a.rollers, a.frictions_N, a.leader.undamped)
    if a.loop.closed != 1.0:
        law.begin_turn(turn, a.orders, angle_rad)
        turn.mean_momentum_Ns = 0.0
        return CONTINUE
    for k in range(len(a.behind)):
        force_N += a.behind[k, 0] * values[a.behind_at[k, 0]]
        momentum_Ns += a.behind[k, 1] * values[a.behind_at[k, 1]]
    seen = (force_N, momentum_Ns, v2_m_s - v1_m_s)
    values[at[4]] += law.compensate(turn, a.orders, a.commands, x1_m, x2_m, v1_m_s, seen)
    return _TURNED if law.end_turn(turn, angle_rad) else CONTINUE


def _friction_N(model: ModelParameters, axis: int) -> Vector:
    """Friction that the model knows of a roller, by speed forward."""
    of = {each.effect: each.parameters for each in model.effects if each.axis == axis}
    found = np.full(SPEEDS, of.get("coulomb_friction", {}).get("force_N", 0.0))
    found += of.get("viscous_friction", {}).get("coefficient_N_s_per_m", 0.0) * _GRID_M_S
    if "stribeck_friction" in of:
        force_N, speed_m_s = (of["stribeck_friction"][name] for name in ("force_N", "speed_m_s"))
        found += force_N * np.exp(-((_GRID_M_S / speed_m_s) ** 2))
    return found


def _size(entry: EffectEntry) -> complex:
    """Amplitude and phase of an effect that goes by the angle: of a cosine."""
    of = entry.parameters
    size = of["amplitude_m"] if entry.effect == "roller_eccentricity" else -1j * of["amplitude_Nm"]
    return complex(size * np.exp(1j * of.get("phase_rad", 0.0)))


class _Turning(NamedTuple):
    """What turns: an effect, and its order in turns of the roller before the span (0) or behind it (1)."""

    effect: Compensable
    behind: int
    order: float


class CompensationTask(StagedTask):
    """Compensation in the span of a tension loop, after that in a cycle."""

    def __init__(self, config: BenchConfig, control: CompensationConfig, reports: Reports, loop: TensionTask) -> None:
        self._config, self._names, self._reports, self._loop = config, loop.names, reports, loop
        model, axis = config.web_line, loop.names.axis
        self._apart = int(abs(model.radius_m(axis + 1) / model.radius_m(axis) - 1.0) > _ONE_RADIUS)
        behind = range(axis + 1, model.axis_count + 1)
        self._behind = np.array([(model.motor_rad_per_m(k), model.mass_kg(k)) for k in behind])
        self._compensated = self._all(control)
        self._orders = np.zeros(len(self._compensated), law.ORDER).view(np.recarray)
        for order, key in zip(self._orders, self._compensated, strict=True):
            order.order, order.radius_m, order.behind = key.order, model.radius_m(axis + key.behind), key.behind
        self._commands = np.zeros((len(self._orders), SPEEDS, 2))
        self._turns = np.zeros(1, law.TURN).view(np.recarray)
        self._turn = self._turns[0]
        self._turn.radius_m, self._turn.limit_m_s = model.radius_m(axis), control.limit_m_s
        self._rollers, self._frictions_N = np.zeros(0, ROLLER), np.zeros((0, SPEEDS))
        if "friction" in control.effects:
            rollers = rollers_of(model, config.cycle_time_s)[axis - 1 : axis + 1]
            self._rollers = np.concatenate(rollers).view(ROLLER)
            self._frictions_N = np.array([_friction_N(model, k) for k in (axis, axis + 1)])
        load(run)

    def _all(self, control: CompensationConfig) -> dict[_Turning, Compensated]:
        """What is compensated: the orders of effects that the model knows, and of others the first."""
        model, axis = self._config.web_line, self._names.axis
        known: dict[_Turning, list[EffectEntry]] = {}
        for effect, behind in product(_BY_ANGLE, (0, 1)):
            of_axis = [each for each in model.effects if each.effect == effect and each.axis == axis + behind]
            of_motor = model.gear_ratio(axis + behind) if effect == "torque_ripple" else 1.0
            for order in {each.parameters.get("order", 1.0): None for each in of_axis} or {1.0: None}:
                key = _Turning(effect, min(behind, self._apart), order * of_motor)
                if effect in control.effects and key._replace(effect=_BY_ANGLE[0]) not in known.keys() - {key}:
                    entries = [each for each in of_axis if each.parameters.get("order", 1.0) == order]
                    known.setdefault(key, []).extend(entries)
        moduli_Pa = tuple(model.youngs_modulus_Pa(span) for span in range(1, model.span_count + 1))
        points = [OperatingPoint(moduli_Pa, speed, (1.0,) * len(moduli_Pa), moduli_Pa) for speed in _GRID_M_S]
        loops = [TensionLoop(self._config, point) for point in points]
        return {key: self._one(control, key, entries, loops) for key, entries in known.items()}

    def _one(
        self, control: CompensationConfig, key: _Turning, entries: list[EffectEntry], loops: list[TensionLoop]
    ) -> Compensated:
        """Responses of an order at all speeds, and what the model knows of it."""
        config, model, span, axis = self._config, self._config.web_line, self._names.span, self._names.axis
        omega, ripple = key.order * _GRID_M_S / model.radius_m(axis + key.behind), key.effect == "torque_ripple"
        pairs = zip(loops, omega, strict=True)
        gain, *of_force, of_pull, of_twin = np.array([loop.responses(span, each) for loop, each in pairs]).T
        gain[omega * config.cycle_time_s > _FASTEST_RAD] = np.inf

        def response(turning: int) -> Complexes:
            if ripple:
                return np.asarray(of_force[turning - axis] * model.motor_rad_per_m(turning))
            web_m_s = (-1.0 if turning == axis else 1.0) * _GRID_M_S / model.radius_m(turning)
            unseen_N = self._strained_N(web_m_s, omega, _GRID_M_S)
            return np.asarray(unseen_N * (1.0 + of_pull + (of_twin if entries else 0.0)))

        known = np.zeros(SPEEDS, complex)
        for entry in entries:
            assert entry.axis is not None, "of an axis"
            known += _size(entry) * response(entry.axis)
        pushes = [each for each in model.effects if each.effect == "unbalance" and each.axis == axis + 1]
        besides_N = sum(map(_size, pushes)) / model.radius_m(axis + 1) if key.behind == self._apart else 0.0
        least_N = 0.01 * control.least_pct * config.tension_controls[span].set_point_N
        return Compensated(gain, response(axis + key.behind), known, besides_N, control.limit_m_s, least_N)

    def _strained_N(self, stretch_m_s: Any, omega: Any, speed_m_s: Any) -> Any:
        """Tension that a rate of stretching makes in the span, at a frequency and a speed of the web."""
        model, span = self._config.web_line, self._names.span
        length_m = model.span_length_m(span)
        return model.stiffness_N(span) / length_m * stretch_m_s / (1j * omega + speed_m_s / length_m)

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage of a cycle, and Python's at the end of a turn."""
        kind, axis = type(sample), self._names.axis
        of_span = [f"x{axis}_m", f"x{axis + 1}_m", f"v{axis}_m_s", f"v{axis + 1}_m_s", self._names.command]
        behind = range(axis + 1, axis + 1 + len(self._behind))
        behind_at = np.array([kind.places([f"tau{k}_Nm", f"v{k}_m_s"]) for k in behind])
        arrays = _Arrays(
            *(np.asarray(self._turns), np.asarray(self._orders), self._commands, self._loop.loop),
            *(kind.places(of_span), behind_at, self._behind, self._loop.leader.speeds),
            *(self._rollers, self._frictions_N, sample.reals),
        )
        stage = CompiledStage(run, 0, arrays, fallback=lambda _: self._turned(sample))
        return CompiledStages(before=[stage], shown={self._names.drive: self._names.command})

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Begin the next turn anew; the drives hold no friction."""
        self._turn.mean_momentum_Ns, self._rollers["held_N"] = 0.0, np.nan

    def _turned(self, sample: CycleSample) -> bool:
        """Learn from a turn of a steady line."""
        turn, radius_m, axis = self._turn, self._config.web_line.radius_m, self._names.axis
        speed_m_s = turn.mean_momentum_Ns / sum(self._behind[:, 1])
        for number, (key, each) in enumerate(self._compensated.items() if turn.is_steady else ()):
            o, omega = self._orders[number], key.order * speed_m_s / radius_m(axis + key.behind)
            sums = [o[f"{name}_c"] - 1j * o[f"{name}_s"] for name in ("force", "momentum", "stretch")]
            force_N, momentum_Ns, stretch_m_s = (2.0 / turn.cycles * each for each in sums)
            left_N = force_N - 1j * omega * momentum_Ns + each.besides_N
            if key.effect == "torque_ripple":
                left_N = self._strained_N(stretch_m_s, omega, speed_m_s)
            self._tell(key, each, each.take(left_N, turn.trend_N, speed_m_s))
            self._commands[number, :, 0], self._commands[number, :, 1] = each.command.real, each.command.imag
        _begin_turn(turn, self._orders, getattr(sample, f"x{axis}_m") / turn.radius_m)
        return True

    def _tell(self, key: _Turning, each: Compensated, event: str) -> None:
        """Note what became of a compensation."""
        if event in _TOLD:
            what = f"{key.effect} of order {key.order:g}, {self._names.of_loop}: {_TOLD[event]}"
            swing = f"the tension swings by {each.swing_N:.2g} N, {each.without_N:.2g} N without"
            self._reports.note("compensation", f"{what} ({swing})", kind=f"{key}{event}")
