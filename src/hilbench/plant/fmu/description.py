"""FMU description (`modelDescription.xml`): its variables with units, and its step capabilities.

FMI 2.0.4 and 3.0.1, co-simulation; read by FMPy, without running any code of the FMU.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hilbench.did_you_mean import closest
from hilbench.errors import UnusableInputError, one_line

if TYPE_CHECKING:
    from collections.abc import Mapping

#: Exponents of kg, m, s and the other SI base units, in the order of `_BASE`.
Exponents = tuple[int, ...]

_BASE: Final = ("kg", "m", "s", "A", "K", "mol", "cd")
_FLOATS: Final = ("Real", "Float64")
_KINDS_OF_PARAMETER: Final = ("parameter", "structuralParameter")
#: Exponents of kg, m, s of a machine's units.
_OF_UNIT: Final[dict[str, tuple[int, int, int]]] = {
    "1": (0, 0, 0),
    "rad": (0, 0, 0),
    "rad/s": (0, 0, -1),
    "m": (0, 1, 0),
    "m/s": (0, 1, -1),
    "s": (0, 0, 1),
    "N": (1, 1, -2),
    "Pa": (1, -1, -2),
    "N·m": (1, 2, -2),
    "kg·m²": (1, 2, 0),
    "N·m·s/rad": (1, 2, -1),
}
_MOST_NAMES: Final = 3
#: Largest size of the unpacked FMU, and of its description, bytes.
_MOST_BYTES: Final = 1_000_000_000
_MOST_DESCRIBED_BYTES: Final = 30_000_000


@dataclass(frozen=True, slots=True)
class Variable:
    """Floating point variable of an FMU: SI value = factor · its value + offset."""

    name: str
    reference: int  #: value reference
    causality: str
    settable: bool  #: at run time: an input or a tunable parameter
    initial: bool  #: settable before the start
    start: float | None  #: in its own unit
    unit: str  #: its own, "" where it has none
    factor: float = 1.0
    offset: float = 0.0

    def si(self, value: float) -> float:
        """SI value in the requested unit."""
        return self.factor * value + self.offset

    def own(self, value: float) -> float:
        """Value in its own unit."""
        return (value - self.offset) / self.factor

    def scaled(self, factor: float, offset: float) -> Variable:
        """Copy with another factor and offset."""
        return replace(self, factor=factor, offset=offset)


@dataclass(frozen=True)
class FmuDescription:
    """Description of an FMU for co-simulation."""

    path: Path
    version: int  #: major, of FMI: 2 or 3
    model: str  #: its name
    identifier: str  #: of its shared library
    token: str  #: GUID or instantiation token
    tool: str  #: generation tool, "" if not stated
    can_roll_back: bool  #: its state can be saved and restored (canGetAndSetFMUstate)
    any_step: bool  #: canHandleVariableCommunicationStepSize
    step_s: float | None  #: its default communication step
    variables: Mapping[str, Variable]
    units: Mapping[str, tuple[Exponents, float, float]]  #: base units, factor and offset to SI, by name

    def find(self, name: str, causality: str, unit: str) -> Variable:
        """Variable by name that is an ``input``, ``output`` or ``parameter``, in an SI unit.

        An output may be any variable but an input. Raises ValueError with the expected ones.
        """
        fitting = [each.name for each in self.variables.values() if _fits(each, causality)]
        found = self.variables.get(name)
        if found is None or not _fits(found, causality):
            like = closest(name, fitting, _MOST_NAMES) or fitting[:_MOST_NAMES]
            known = f" such as {', '.join(repr(each) for each in like)}" if like else ", which it has none of"
            is_none = f"'{name}' is none" if found is None else f"'{name}' is of causality {found.causality}"
            raise ValueError(
                f"an {causality} of {self.path.name}{known}; {is_none}".replace("an parameter", "a parameter")
            )
        return self._in_si(found, unit)

    def _in_si(self, variable: Variable, unit: str) -> Variable:
        known = self.units.get(variable.unit)
        wanted = _OF_UNIT.get(unit)
        if known is None or wanted is None:
            return variable
        exponents, factor, offset = known
        if exponents != (*wanted, *[0] * (len(_BASE) - 3)):
            raise ValueError(f"a variable in {unit}, or a unit of its kind; '{variable.name}' is in {variable.unit}")
        return variable.scaled(factor, offset)

    @property
    def summary(self) -> str:
        """One-line summary for the user."""
        counts = {
            causality: sum(_fits(each, causality) for each in self.variables.values() if each.causality != "local")
            for causality in ("input", "output", "parameter")
        }
        steps = "steps of any length" if self.any_step else "steps of one length"
        asked = f", asks for {self.step_s * 1e3:g} ms" if self.step_s else ""
        state = "its state can be taken and given back" if self.can_roll_back else "its state can't be taken back"
        made = f", made by {self.tool}" if self.tool else ""
        return (
            f"FMU {self.path.name}: {self.model}, FMI {self.version} co-simulation{made}; "
            f"{counts['input']} inputs, {counts['output']} outputs, {counts['parameter']} parameters; "
            f"{steps}{asked}; {state}"
        )


def _fits(variable: Variable, causality: str) -> bool:
    if causality == "parameter":
        return variable.causality in _KINDS_OF_PARAMETER
    return variable.causality == "input" if causality == "input" else variable.causality in ("output", "local")


def read_fmu(path: Path) -> FmuDescription:
    """Description of an FMU. Raises UnusableInputError with the file, found and expected."""
    if not path.is_file():
        raise UnusableInputError(path, "no such file, expected an FMU (.fmu)")
    return _read(path.resolve(), path.stat().st_mtime_ns)


def _check_size(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
    described = sum(entry.file_size for entry in entries if entry.filename == "modelDescription.xml")
    whole = sum(entry.file_size for entry in entries)
    for what, size, most in (("modelDescription.xml", described, _MOST_DESCRIBED_BYTES), ("it", whole, _MOST_BYTES)):
        if size > most:
            raise UnusableInputError(
                path, f"{what} is {size / 1e6:.0f} MB when unpacked, expected at most {most / 1e6:g} MB"
            )


@lru_cache(16)
def _read(path: Path, _changed_ns: int) -> FmuDescription:
    try:
        from fmpy import read_model_description
    except ImportError:
        raise UnusableInputError(path, "FMPy is not installed, expected it (pip install 'hilbench[fmi]')") from None
    try:
        _check_size(path)
        found: Any = read_model_description(str(path), validate=True)
    except UnusableInputError:
        raise
    except (zipfile.BadZipFile, KeyError, OSError):
        raise UnusableInputError(path, "no FMU, expected a zip archive with a modelDescription.xml") from None
    except Exception as error:  # FMPy raises Exception for all errors of the file
        text = one_line(error)
        raise UnusableInputError(path, f"{text}, expected a modelDescription.xml as FMI 2 or 3 has it") from None
    major = int(str(found.fmiVersion).split(".")[0])
    if major not in (2, 3):
        raise UnusableInputError(path, f"FMI {found.fmiVersion}, expected FMI 2 or 3")
    simulation = found.coSimulation
    if simulation is None:
        raise UnusableInputError(path, "an FMU without co-simulation, expected one with it")
    experiment = found.defaultExperiment
    asked = simulation.fixedInternalStepSize or (experiment.stepSize if experiment else None)
    variables = [each for each in found.modelVariables if each.type in _FLOATS and not each.dimensions]
    return FmuDescription(
        path=path,
        version=major,
        model=str(found.modelName),
        identifier=str(simulation.modelIdentifier),
        token=str(found.guid),
        tool=str(found.generationTool or ""),
        can_roll_back=bool(simulation.canGetAndSetFMUstate),
        any_step=bool(simulation.canHandleVariableCommunicationStepSize),
        step_s=float(asked) if asked else None,
        variables={each.name: _variable(each) for each in variables},
        units={
            unit.name: (
                tuple(getattr(unit.baseUnit, base) for base in _BASE),
                float(unit.baseUnit.factor),
                float(unit.baseUnit.offset),
            )
            for unit in found.unitDefinitions
            if unit.baseUnit is not None
        },
    )


def _variable(found: Any) -> Variable:
    parameter = found.causality in _KINDS_OF_PARAMETER
    declared = found.declaredType.unit if found.declaredType is not None else None
    return Variable(
        name=str(found.name),
        reference=int(found.valueReference),
        causality=str(found.causality or "local"),
        settable=found.causality == "input" or (parameter and found.variability == "tunable"),
        initial=parameter or found.causality == "input" or found.initial in ("exact", "approx"),
        start=None if found.start is None else float(found.start),
        unit=str(found.unit or declared or ""),
    )
