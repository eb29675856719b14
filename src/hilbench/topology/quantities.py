"""The quantities of a running bench that an experiment may change, by path, and what values each of them may have.

`line_speed_m_s`, `tension_control.set_point_N`, `load.web.youngs_modulus_Pa`, `load.web.broken` (1: the web
has torn and pulls no more; 0: it is whole), `tension_control.probe` (1: a probe is wanted; 0: none),
`twin.model_change` (the word on a change of the twin's model that the diagnosis beside the run proposes, 1: go on with
it, 0: do not), and any parameter of any effect, hidden in the emulated mechanics or in the simulated hardware:
`load.effects.elasticity_drift.rate_per_s`, `hardware.effects.coulomb_friction.axis1.force_N`. On a line of several
spans a set-point has the number of its span: `tension_control.span2.set_point_N`; E and the effects of a span are
those of all spans, or with its number of one: `load.web.span2.youngs_modulus_Pa`,
`load.effects.elasticity_drift.span2.rate_per_s`. A dancer or accumulator with a loop of its position has
`position_control.NAME.set_point_m` and `position_control.NAME.feed` (1: the axis before it feeds the line, 0: it
is at rest), with a force that is fed forward `position_control.NAME.force.set_point_N`. Of a servo axis: `speed_rad_s`,
`load.shaft.inertia_kg_m2`, `load.shaft.coulomb_friction_Nm`, `load.shaft.viscous_friction_Nm_s_per_rad`.

The ranges here are those of values with a meaning, whatever the config. What an operator may ask for of a running
bench is less (`hilbench.bench.operator.operator_objects`), and `safety: limits` end a run before that.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import product
from math import isfinite
from numbers import Real

from hilbench.did_you_mean import closest, did_you_mean
from hilbench.errors import UnusableValueError
from hilbench.machine_kinds import machine_part, recorded
from hilbench.plant.effect import EffectPlace, MachineKind
from hilbench.plant.effects import effect_problem, effects_of, find_effect
from hilbench.plant.model_file import Machine
from hilbench.topology import web_line_quantities as numbered
from hilbench.topology.signals import Shape, smallest_shapes
from hilbench.topology.web_line_quantities import FEED, FORCE_SET_POINT, SET_POINT, position_quantity, positions

LINE_SPEED = "line_speed_m_s"
MODEL_CHANGE = "twin.model_change"
SPEED = "speed_rad_s"
SHAFT_INERTIA = "load.shaft.inertia_kg_m2"
SHAFT_COULOMB_FRICTION = "load.shaft.coulomb_friction_Nm"
SHAFT_VISCOUS_FRICTION = "load.shaft.viscous_friction_Nm_s_per_rad"

#: Longest time that a step of an experiment may take, s: twelve days. More is a wrong unit, and fits no memory.
LONGEST_S = 1e6


@dataclass(frozen=True)
class Permitted:
    """Permitted values of a quantity: finite numbers from `lower` to `upper` (inclusive), in `unit` ("1": a ratio).

    As text it states what was expected: ``a number from 0 to 100000 N``.
    """

    lower: float
    upper: float
    unit: str
    only_ends: bool = False  #: a switch: `lower` or `upper`, nothing between

    def holds(self, value: object) -> bool:
        """True if `value` is permitted. Texts are not, and truth values only where there is a switch."""
        number = _number(value, truth=self.only_ends)
        if number is None or not self.lower <= number <= self.upper:
            return False
        return not self.only_ends or number in (self.lower, self.upper)

    def __str__(self) -> str:
        if self.only_ends:
            return f"{self.lower:g} or {self.upper:g}"
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"a number from {self.lower:g} to {self.upper:g}{unit}"


def _number(value: object, *, truth: bool) -> float | None:
    if not isinstance(value, Real) or (isinstance(value, bool) and not truth):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if isfinite(number) else None


@cache
def single_paths() -> Mapping[str, Permitted]:
    """The quantities of all kinds of machine by path, but for those with the number or name of a part."""
    return {path: values for each in recorded("topology").values() for path, values in each.QUANTITIES.items()}


_OF_POSITIONS = {
    SET_POINT: Permitted(-100.0, 100.0, "m"),
    FEED: Permitted(0.0, 1.0, "1", only_ends=True),
    FORCE_SET_POINT: Permitted(0.0, 1e5, "N"),
}
#: Number of quantities that are suggested for a misspelt one.
_MOST_NEAR = 3
_PART = re.compile(r"([a-z]+)([1-9]\d{0,3})")


def _permitted_of_none(path: str) -> Permitted | None:
    """Permitted values of a quantity that is none of an effect, on any machine; None: it is one, or unknown."""
    return single_paths().get(numbered.without_number(path)) or _OF_POSITIONS.get(position_quantity(path))


def is_simple_path(path: str) -> bool:
    """True if a quantity is none of an effect, on any machine."""
    return _permitted_of_none(path) is not None


@dataclass(frozen=True)
class EffectPath:
    """One parameter of one effect, in the emulated mechanics (`load`) or the simulated `hardware`."""

    place: str
    effect: str
    axis: int | None
    parameter: str
    kind: MachineKind = MachineKind.WEB_LINE  #: by whose rows the parameter is named
    section: int | None = None  #: behind which axis; None: everywhere, or the effect is of an axis


@cache
def parse_effect_path(text: str, kind: MachineKind | None = None) -> EffectPath:
    """Parse ``load|hardware.effects.ID[.axisN|.spanN].PARAMETER`` for a kind of machine (None: any).

    The bench checks axes and sections (`path_problem`). Raises ValueError that states what is wrong.
    """
    if kind is not None:
        return _parsed(text, kind)
    try:
        return _parsed(text, MachineKind.WEB_LINE)
    except ValueError:
        with suppress(ValueError):  # the first kind's words say more
            return _parsed(text, MachineKind.SERVO_AXIS)
        raise


def _parsed(text: str, kind: MachineKind) -> EffectPath:
    parts = text.split(".")
    if len(parts) not in (4, 5) or parts[0] not in list(EffectPlace) or parts[1] != "effects":
        raise ValueError(_expected(text))
    place, _, name, *part, parameter = parts
    try:
        effect = find_effect(name, kind)
    except KeyError:
        meant = did_you_mean(name, (effect.id for effect in effects_of(kind)))
        raise ValueError(f"an effect of the vocabulary, '{name}' is none{meant}") from None
    if effect.stations:
        raise ValueError(f"a quantity that changes while a bench runs: '{name}' is there from the start on")
    at = _PART.fullmatch(part[0]) if part else None
    number = int(at[2]) if at and at[1] == effect.part else None
    axis, section = (number, None) if effect.per_axis else (None, number)
    if effect.per_axis and axis is None:
        raise ValueError(f"'{name}' with its axis: {place}.effects.{name}.axisN.{parameter}")
    if part and number is None:
        more = f", or with its {effect.part}: {place}.effects.{name}.{effect.part}N.{parameter}"
        raise ValueError(f"'{name}' without an axis: {place}.effects.{name}.{parameter}{more if effect.part else ''}")
    names = [known.name for known in effect.parameters]
    if parameter not in names:
        meant = did_you_mean(parameter, names)
        raise ValueError(f"a parameter of '{name}' ({', '.join(names)}), '{parameter}' is none{meant}")
    problem = effect_problem(name, axis, EffectPlace(place), None, None, kind, section=section)
    if problem:
        raise ValueError(problem)
    return EffectPath(place, name, axis, parameter, kind, section)


def _expected(text: str) -> str:
    """Text of what is expected in place of one that is no path: the nearest path, else all paths."""
    station = text.split(".")[1] if re.fullmatch(r"position_control\.[A-Za-z]\w*(\..*)?", text) else "NAME"
    further = positions((station,), (station,))
    near = closest(text, [*single_paths(), *further, *all_paths()], _MOST_NEAR)
    if near:
        return f"one of {', '.join(near)}, …, did you mean '{near[0]}'?"
    known = ", ".join([*single_paths(), *further])
    return f"one of {known}, or load|hardware.effects.ID[.axisN|.spanN].PARAMETER"


def fast_path_places(kind: str, shape: Shape) -> tuple[str, ...]:
    """The quantities of a machine, without those of its effects."""
    several = numbered.several(shape)
    paths_of_kind = [
        path for known in machine_part(kind, "topology").QUANTITIES for path in several.get(known, [known])
    ]
    return (*paths_of_kind, *positions(shape.positioned, shape.pushed))


def path_problem(path: str, machine: Machine, shape: Shape, loaded: Collection[int]) -> str | None:
    """Why a machine has no such quantity, in one line, or None; `loaded`: axes on whose shaft a load motor is."""
    kind, known = machine.machine_kind, fast_path_places(machine.kind, shape)
    if path in known:
        return None
    if is_simple_path(path):
        of_kind = machine_part(machine.kind, "topology").QUANTITIES
        other = "another kind of machine" if path in single_paths() and path not in of_kind else "another machine"
        return f"a quantity of a {machine.kind} ({', '.join(known)}), '{path}' is of {other}"
    try:
        of = parse_effect_path(path, kind)
    except ValueError as error:
        return str(error)
    place, sections = EffectPlace(of.place), shape.spans
    return effect_problem(of.effect, of.axis, place, shape.axes, loaded, kind, section=of.section, sections=sections)


def all_paths() -> Iterator[str]:
    """Every path that can be set on the smallest machine of each kind."""
    yield from single_paths()
    for kind, effect in ((each, effect) for each in MachineKind for effect in effects_of(each)):
        axes = smallest_shapes()[kind].axes
        for place, axis in product(EffectPlace, range(1, axes + 1) if effect.per_axis else (None,)):
            if not effect_problem(effect.id, axis, place, axes, (axes,), kind):
                at = f"{place}.effects.{effect.id}." + ("" if axis is None else f"axis{axis}.")
                yield from (at + parameter.name for parameter in effect.parameters)


def settable_path(text: str) -> str:
    """The path itself when it names a quantity that can be set; ValueError otherwise."""
    if not is_simple_path(text):
        parse_effect_path(text)
    return text


def rampable_path(text: str) -> str:
    """The path itself when it names a quantity that can have every value between two; ValueError otherwise."""
    if permitted(text).only_ends:
        raise ValueError(f"a quantity that can be ramped, '{text}' is a switch")
    return text


@cache
def permitted(path: str) -> Permitted:
    """Permitted values of a quantity. Raises ValueError for an unknown path."""
    simple = _permitted_of_none(path)
    if simple is not None:
        return simple
    of = parse_effect_path(path)
    parameter = find_effect(of.effect, of.kind).parameter(of.parameter)
    return Permitted(parameter.lower, parameter.upper, parameter.unit)


def checked_path(path: object, check: Callable[[str], str] = settable_path) -> str:
    """The path when it is text that passes `check`. Raises UnusableValueError: what was found, what was expected."""
    try:
        if isinstance(path, str):
            return check(path)
        expected = f"text such as '{LINE_SPEED}'"
    except ValueError as error:
        expected = str(error)
    raise UnusableValueError(f"path {path!r}, expected {expected}")


def checked_duration_s(name: str, value: object, *, above_zero: bool = False) -> float:
    """A time in s as a number. Raises UnusableValueError that names it, what was found and what was expected."""
    number = _number(value, truth=False)
    if number is None or not 0.0 <= number <= LONGEST_S or (above_zero and number == 0.0):
        least = "above 0 and up" if above_zero else "from 0"
        raise UnusableValueError(f"{name} is {value!r}, expected a number {least} to {LONGEST_S:g} s")
    return number


def checked_value(path: str, value: object) -> float:
    """The value as a number when the quantity may have it.

    Raises UnusableValueError (a ValueError) that names the path, what was found and what was expected; ValueError for
    an unknown path.
    """
    allowed = permitted(path)
    if not allowed.holds(value):
        raise UnusableValueError(f"{path} is {value!r}, expected {allowed}")
    return float(value)  # type: ignore[arg-type]  # a Real, as `holds` has seen
