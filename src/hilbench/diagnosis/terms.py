"""Candidates: effects of the vocabulary as terms of a fit, in coordinates in which a fit is well-behaved.

An amplitude with a phase is fitted by its two components; everything else by its own parameters. What an effect
is, its parameters, units, bounds and step sizes are in `hilbench.plant.effects` alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import atan2, cos, hypot, sin
from typing import Final, NamedTuple

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.plant.effect import Effect, ProbeOver, Section
from hilbench.plant.effects import EFFECTS, STATION_EFFECTS
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry

_PHASE = "phase_rad"


class Place(NamedTuple):
    """An effect (by its id), or what it may be mistaken for, at an axis, in a span, or in all of the machine."""

    effect: str
    axis: int | None = None
    section: Section | None = None

    @classmethod
    def of(cls, entry: EffectEntry) -> Place:
        """Place of an effect as a model file has it."""
        return cls(entry.effect, entry.axis, entry.section)

    @property
    def text(self) -> str:
        """Text for a person."""
        return self.effect + (f" of {self.where}" if self.where else "")

    @property
    def where(self) -> str:
        """The part of the machine; "" for all of it."""
        if isinstance(self.section, str):
            return self.section
        return f"axis {self.axis}" if self.axis else f"span {self.section}" if self.section else ""

    def beside(self, other: Place) -> str:
        """Name of what is tied with another: with its part of the machine where that is not the other's."""
        return self.effect if self.where in ("", other.where) else f"{self.effect} ({self.where})"


#: Place of an effect in the table: among explanations that do as well the first is named.
RANK: Final = {effect.id: place for place, effect in enumerate(EFFECTS + STATION_EFFECTS)}

#: Place, slot and part of a term.
Key = tuple[Place, int, str | None]


@dataclass(frozen=True)
class Term:
    """One effect at one place, with values.

    `axis` counts from 1 and is None for the web; `section`, the number of a span, as well, and is None for all spans,
    or the only one; of an effect of a station it is the station's name; `slot` counts what the place has of the effect,
    from 0. `values` and `base` have every parameter of the effect by name, in its unit.
    """

    effect: Effect
    axis: int | None
    slot: int
    values: Mapping[str, float]
    base: Mapping[str, float]  #: values in the model that is diagnosed
    shape_steps: Mapping[str, float]  #: finite-difference steps of the parameters that only shape it
    size: float  #: of its strength on this machine, when it shows clearly
    multiplicity: float = 1.0  #: how many variants (orders, frequencies, times) were searched to propose this one
    probe: float | None = None  #: strength at which its response is looked at; default: a fifth of its size
    aimed: bool = False  #: its time has been searched for
    least: Mapping[str, float] = field(default_factory=dict)  #: below which a shape can't be known from a recording
    part: str | None = None  #: of an effect with several strengths the one that this term is; the others are not its
    held: frozenset[str] = frozenset()  #: shapes that are known and not fitted
    section: Section | None = None

    @property
    def key(self) -> Key:
        """Key of the term in the model."""
        return self.place, self.slot, self.part

    @property
    def place(self) -> Place:
        """Place of the effect."""
        return Place(self.effect.id, self.axis, self.section)

    @property
    def is_searched(self) -> bool:
        """True if a parameter of it has to be searched for, because the sum of squares has many minima in it."""
        return self.probe is not None or (self.is_sudden and not self.aimed)

    @property
    def is_sudden(self) -> bool:
        """True if it sets in at once, at a time of its own."""
        return self.effect.probe is not None and self.effect.probe.over in (ProbeOver.ONSET, ProbeOver.PASSAGE)

    @property
    def onset(self) -> str:
        """Name of the parameter that is the time from which it acts, s. Raises ValueError for a term without one."""
        probe = self.effect.probe
        if probe is None or probe.over not in (ProbeOver.ONSET, ProbeOver.ONSET_AND_DURATION, ProbeOver.PASSAGE):
            raise ValueError(f"effect '{self.effect.id}' sets in at no time of its own")
        return probe.parameter

    @property
    def time_s(self) -> float:
        """The time from which it acts, s. Raises ValueError for a term without one."""
        return self.values[self.onset]

    @property
    def duration_s(self) -> float:
        """Time that it takes to grow, s; 0 if it sets in at once."""
        probe = self.effect.probe
        return self.values[probe.duration] if probe is not None and probe.duration else 0.0

    def overlaps(self, other: Term) -> bool:
        """True if both write the same values of a model: one of all spans those of each."""
        (place, *rest), (its, *others) = self.key, other.key
        return (
            rest == others
            and place[:2] == its[:2]
            and (place.section == its.section or None in (place.section, its.section))
        )

    def moved_to(self, time_s: float) -> Term:
        """Term from another time on. Raises ValueError for a term without one."""
        return replace(self, values={**self.values, self.onset: time_s})

    def stays_at(self, name: str) -> bool:
        """True if a parameter is a time that has been searched for already."""
        return self.aimed and name == self.onset

    @property
    def has_phase(self) -> bool:
        """True if strength and phase are fitted as two components."""
        return any(p.name == _PHASE for p in self.effect.parameters)

    @property
    def is_of_a_frequency(self) -> bool:
        """True if it shows near a frequency of its own, and not in a band without that."""
        return self.has_phase or (self.effect.probe is not None and self.effect.probe.over is ProbeOver.FREQUENCIES)

    @property
    def is_torsional(self) -> bool:
        """True if it is a resonance of a part of the machine."""
        return self.is_of_a_frequency and not self.has_phase

    @property
    def _strength(self) -> str:
        return self.part or self.effect.strength[0]

    def _shapes(self) -> list[str]:
        return [p.name for p in self.effect.parameters if p.name not in (*self.effect.strength, _PHASE, *self.held)]

    @property
    def own(self) -> dict[str, float]:
        """Values of the term, without those of other parts of the same effect."""
        others = [name for name in self.effect.strength if name != self._strength]
        return {name: value for name, value in self.values.items() if name not in others}

    @property
    def linear(self) -> int:
        """Number of coordinates the model is nearly linear in: the strength, or its two components."""
        return 2 if self.has_phase else 1

    def coordinates(self, values: Mapping[str, float] | None = None) -> Array:
        """Strength (or its two components), then shape; of `values`, or its own."""
        values = self.values if values is None else values
        strength = values[self._strength]
        head = [strength]
        if self.has_phase:
            head = [strength * cos(values[_PHASE]), strength * sin(values[_PHASE])]
        return np.array(head + [values[name] for name in self._shapes()])

    def at(self, coordinates: Array) -> Term:
        """Term with these coordinates, within the parameters' bounds."""
        values = dict(self.values)
        if self.has_phase:
            values[self._strength] = hypot(coordinates[0], coordinates[1])
            values[_PHASE] = atan2(coordinates[1], coordinates[0])
        else:
            values[self._strength] = float(coordinates[0])
        values |= dict(zip(self._shapes(), map(float, coordinates[self.linear :]), strict=True))
        for p in self.effect.parameters:
            values[p.name] = min(max(values[p.name], p.lower, self.least.get(p.name, p.lower)), p.upper)
        return replace(self, values=values)

    def stepped(self, coordinate: int, step: float) -> Term:
        """Term with one of its coordinates larger by a step."""
        moved = self.coordinates()
        moved[coordinate] += step
        return self.at(moved)

    def of_strength(self, strength: Array) -> Term:
        """Term of the same shape with another strength, or its two components."""
        return self.at(np.concatenate([strength, self.coordinates()[self.linear :]]))

    def neutral(self) -> Term:
        """Term with the strength that the diagnosed model has, the shape unchanged."""
        values = dict(self.values)
        values[self._strength] = self.base[self._strength]
        if self.has_phase:
            values[_PHASE] = self.base[_PHASE]
        return replace(self, values=values)

    @property
    def moved(self) -> Array:
        """Strength (or its two components) less that of the diagnosed model."""
        return self.coordinates()[: self.linear] - self.neutral().coordinates()[: self.linear]

    def probes(self) -> Array:
        """Steps of the coordinates in which the model is nearly linear, with which a response is looked at."""
        return self.steps()[: self.linear] if self.probe is None else np.full(self.linear, self.probe)

    def steps(self) -> Array:
        """Finite-difference steps of the coordinates."""
        return np.array([0.2 * self.size] * self.linear + [self.shape_steps[name] for name in self._shapes()])

    def free(self) -> list[str]:
        """Names of what is fitted, one for each coordinate."""
        head = [self._strength, _PHASE] if self.has_phase else [self._strength]
        return head + self._shapes()

    def allowed(self, strength: float) -> bool:
        """True if a strength (of a term without phase) is within its bounds."""
        parameter = self.effect.parameter(self._strength)
        return self.has_phase or parameter.lower <= strength <= parameter.upper

    def gradient(self) -> Array:
        """(parameters, coordinates): derivatives of the named parameters `free()` by the coordinates."""
        size = len(self.coordinates())
        matrix = np.eye(size)
        if self.has_phase:
            amplitude, phase = max(self.values[self._strength], 1e-300), self.values[_PHASE]
            matrix[0, :2] = cos(phase), sin(phase)
            matrix[1, :2] = -sin(phase) / amplitude, cos(phase) / amplitude
        return matrix


def parts(terms: Sequence[Term]) -> list[slice]:
    """The coordinates of each term among those of all."""
    edges = np.cumsum([0, *(len(term.coordinates()) for term in terms)])
    return [slice(int(low), int(high)) for low, high in pairwise(edges)]


def strength_parts(terms: Sequence[Term]) -> list[slice]:
    """Coordinates of each term in which the model is nearly linear."""
    return [slice(part.start, part.start + term.linear) for term, part in zip(terms, parts(terms), strict=True)]


def pack_with(model: Machine, terms: list[Term], base: Array | None = None) -> Array:
    """The kernel's parameter vector of a model with these terms; base: that of the model, where it is known."""
    kind = machines.of_kind(model)
    parameters = machines.packed(model) if base is None else base.copy()
    for term in sorted(terms, key=_of_all_first):
        kind.write_effect(model, parameters, term.effect, term.axis, term.slot, term.own, term.section)
    return parameters


def extended(model: Machine, terms: list[Term]) -> Machine:
    """The model with the terms in its effects; a term at a place where the model has the effect replaces its values."""
    entries: list[EffectEntry] = list(model.effects)
    for term in sorted(terms, key=_of_all_first):
        if isinstance(term.section, int):
            entries = _by_section(entries, term.effect.id, model.span_count)
        positions = [k for k, e in enumerate(entries) if Place.of(e) == term.place]
        if term.slot < len(positions):
            before = entries[positions[term.slot]]
            entries[positions[term.slot]] = before.model_copy(update={"parameters": before.parameters | term.own})
        else:
            entries.append(machines.entry(model, term.effect.id, term.axis, term.own, term.section))
    return machines.with_effects(model, entries)


def _of_all_first(term: Term) -> bool:
    return term.section is not None


def _by_section(entries: list[EffectEntry], effect_id: str, sections: int) -> list[EffectEntry]:
    """Entries of an effect for each span instead of one for all of them."""
    found: list[EffectEntry] = []
    for entry in entries:
        if entry.effect == effect_id and entry.section is None:
            found += [entry.model_copy(update={"span": number}) for number in range(1, sections + 1)]
        else:
            found.append(entry)
    return found
