"""Kinds of machine, found by the entry points `hilbench.machines`: those of hilbench and of other packages alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

from hilbench.did_you_mean import expected_one_of
from hilbench.errors import UnusableInputError

GROUP: Final = "hilbench.machines"
#: Kind of a machine that names none.
DEFAULT: Final = "web_line"


@dataclass(frozen=True, kw_only=True)
class MachineDescription:
    """Parts of a kind of machine: each "module:object", or a module with these names, imported when it is needed.

    Of functions that make a part the arguments follow in brackets. A kind may lack those with a default.
    """

    parameters: str  #: class of the block `machine:`, a `hilbench.block.Block`
    topology: str  #: with the names of `hilbench.topology.servo_axis`
    hardware: str  #: simulated, a `hilbench.plant.interface.Plant`: (config, ports, seed)
    twin: str  #: `hilbench.twin.machines.machine.TwinMachine`: (model, config, shape, cycle_s, boundary inputs)
    tasks: str  #: `hilbench.bench.machines.machine.MachineTasks`: (config, state)
    check: str  #: notes; raises UnusableInputError for a config that can't be run: (config, document, nodes)
    ranges: str  #: least and largest value that an operator may set, by path of an object 2200h: (config)
    check_steps: str  #: `hilbench.runs.check.CheckedExperiment`: (loaded, bench, moves, with_margins=…)
    start_values: str  #: of the quantities, by path: (config)
    metrics: str  #: `hilbench.runs.machines.machine.MachineMetrics`: (shape)
    panels: str  #: what is shown of it, `hilbench.apps.report.panel.MachinePanels`: (shape)
    page: str  #: with `drawing` and `settled`, as of `hilbench.apps.pages.live.machines.servo_axis`
    prediction: str = ""  #: with `look` and `foreseen`, as of `hilbench.bench.prediction.servo_axis`
    diagnosis: str = ""  #: with the names of `hilbench.diagnosis.servo_axis`
    live_diagnosis: str = ""  #: `hilbench.live.machine.LiveMachine`: (config)
    commissioning: str = ""  #: `hilbench.runs.commissioning.Reach`: (config, place)
    fmu_export: str = ""  #: `hilbench.plant.fmu.export.machine.ExportedMachine`: (machine, drives=…, load=…)
    #: Kind whose signals its recordings have, if not its own.
    recorded_as: str = ""


@cache
def kinds() -> Mapping[str, EntryPoint]:
    """All kinds, importing none of them; ours first, which no other package replaces: recordings without signals of
    another package's machine are of one of ours. Raises UnusableInputError for hilbench installed without entry points.
    """

    def rank(point: EntryPoint) -> tuple[bool, bool, str]:
        return point.name == DEFAULT, point.dist is not None and point.dist.name == "hilbench", point.name

    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=GROUP), key=rank, reverse=True):
        found.setdefault(point.name, point)
    if DEFAULT not in found:
        raise UnusableInputError(
            "hilbench", f"the installed package has no entry points '{GROUP}', expected it to be installed again (pip)"
        )
    return found


@cache
def description(kind: str) -> MachineDescription:
    """Description of a kind. Raises UnusableInputError for one that no package brings, or that can't be imported."""
    if kind not in kinds():
        raise UnusableInputError(f"machine of kind {kind}", f"there is none{expected_one_of(kind, kinds())}")
    loaded: MachineDescription = _imported(kind, kinds()[kind].value)
    return loaded


@cache
def machine_part(kind: str, name: str) -> Any:
    """Part of a kind, by its name in the description. Raises UnusableInputError as `description`, and for a part that
    the kind does not bring."""
    place = getattr(description(kind), name)
    if not place:
        raise UnusableInputError(f"machine of kind {kind}", f"brings no {name.replace('_', ' ')}")
    return _imported(kind, place)


def has(kind: str, name: str) -> bool:
    """True if a kind brings a part."""
    return bool(getattr(description(kind), name))


def _imported(kind: str, place: str) -> Any:
    try:
        return EntryPoint(kind, place, GROUP).load()
    except Exception as error:  # whatever another package raises
        package = kinds()[kind].dist
        raise UnusableInputError(
            f"machine of kind {kind}",
            f"package {package.name if package else place} can't be imported ({type(error).__name__}: {error})",
        ) from error


@cache
def importable(name: str) -> Mapping[str, Any]:
    """A part of every kind that can be imported."""
    found = {}
    for kind in kinds():
        try:
            found[kind] = machine_part(kind, name)
        except UnusableInputError:
            continue  # reported where somebody asks for this kind
    return found


@cache
def recorded(name: str) -> Mapping[str, Any]:
    """A part of every kind with recordings of its own."""
    return {kind: each for kind, each in importable(name).items() if not description(kind).recorded_as}


def problems() -> Iterator[str]:
    """Why kinds can't be imported, a line each."""
    for kind in kinds():
        try:
            machine_part(kind, "parameters")
        except UnusableInputError as error:
            yield str(error)
