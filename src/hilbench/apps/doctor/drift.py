"""Changes of a stand since its last run: its nodes, their EDS files, its config. Pure functions.

A node is compared with what it said before the last run configured it, and with what that run wrote: either may be
there now, by whether it was restarted since. What is neither was changed by somebody, or lost.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import isclose
from typing import TYPE_CHECKING, Any, Final, Literal

from hilbench.apps.canopen_tools.eds_match import EdsFile, fitting
from hilbench.canopen import eds
from hilbench.canopen.data_types import data_type
from hilbench.cia402.axis import object_of
from hilbench.cia402.units import DriveUnits
from hilbench.errors import UnusableInputError
from hilbench.exchange.addressing import declared_units, dictionary_of
from hilbench.exchange.node_data import UNITS, EdsObject, Key, StandData, eds_objects, name_of, text_of
from hilbench.runs.config import ExperimentConfig
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Part, parse_object

if TYPE_CHECKING:
    from canopen.objectdictionary import ODVariable

    from canopen import ObjectDictionary

Kind = Literal["config", "eds", "missing", "identity", "units", "parameter", "pdo", "reset"]
#: A key of the config that would match the present value, and that value.
Write = tuple[tuple[str, ...], Any]
NodeAnswers = Mapping[str, Mapping[Key, bytes | None]]

#: Keys of a config that say nothing of the stand.
_NOT_OF_THE_STAND: Final = {
    *("name", "description", "stand", "history", "wear_limits"),
    *("seed", "pace", "steps", "criteria", "recording", "trace"),
}
_DEVICE: Final = (0x1000, 0x1008, 0x1009, 0x100A, 0x1018)
_PDO: Final = range(0x1400, 0x1C00)
#: Of what must be a file's: device profile (the low half of 1000h), vendor-ID, product code, revision.
_BY_THE_FILE: Final[tuple[tuple[Key, int], ...]] = (
    ((0x1000, 0), 0xFFFF), ((0x1018, 1), 0xFFFFFFFF), ((0x1018, 2), 0xFFFFFFFF), ((0x1018, 3), 0xFFFFFFFF),
)  # fmt: skip


@dataclass(frozen=True)
class Drift:
    """One thing that is not what it was. `key` names it for `--write`; `last_run` is what it was in the last run, `eds`
    by the EDS file, as texts (None: not known, or not compared); `write`: values by key of the config that would match
    the present one, none where no key could say it."""

    kind: Kind
    key: str
    what: str
    now: str
    last_run: str | None = None
    eds: str | None = None
    write: Mapping[tuple[str, ...], Any] = field(default_factory=dict)

    def __str__(self) -> str:
        by_node = [f"{self.last_run} in the last run"] if self.last_run is not None else []
        by_node += [f"{self.eds} by its EDS file"] if self.eds is not None else []
        return f"{self.key}: {self.what}: {self.now}" + (f", {', '.join(by_node)}" if by_node else "")


def drifts(
    config: ExperimentConfig,
    by_node: NodeAnswers,
    last: StandData | None,
    last_config: BenchConfig | None,
    *,
    fresh: frozenset[str],
    files: Sequence[EdsFile] = (),
) -> list[Drift]:
    """Find all changes. `by_node`: present answers of the drives, by part (nothing of one that is silent, no entry for
    one that was not read); `last`: what the last run of the stand kept; `fresh`: the parts that have just been
    started; `files`: EDS files among which that of an exchanged device may be. Raises UnusableInputError for an EDS
    file.
    """
    found = [] if last_config is None else list(_of_config(config, last_config))
    found += [] if last is None else list(_of_files(config, last))
    for part in config.stand_drives:
        if part.name in by_node:
            found += _of_node(part, by_node[part.name], last, fresh=part.name in fresh, files=files)
    return found


# -- the config ------------------------------------------------------------------------------------------


def _of_config(config: BenchConfig, last: BenchConfig) -> Iterator[Drift]:
    now, before = (_flat(_of_stand(each)) for each in (config, last))
    for key in sorted(now.keys() | before.keys()):
        if now.get(key) != before.get(key):
            yield Drift("config", ".".join(key), "config", _text(now.get(key)), _text(before.get(key)))


def _of_stand(config: BenchConfig) -> dict[str, Any]:
    data = config.model_dump(mode="json", exclude_none=True)
    for key in _NOT_OF_THE_STAND & data.keys():
        del data[key]
    data["bus"].pop("address", None)  # one bus under another name
    for group in ("drives", "load_motors"):  # of a file it is the content that counts
        for node in data[group].values():
            node.pop("eds", None)
            node.get("virtual", {}).pop("eds", None)
    data["twin"]["node"].pop("eds", None)
    return data


def _flat(data: Any, place: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    if isinstance(data, Mapping):
        return {key: value for name in data for key, value in _flat(data[name], (*place, str(name))).items()}
    return {place: data}


def _text(value: Any) -> str:
    return "not given" if value is None else str(value)


# -- EDS files -------------------------------------------------------------------------------------------


def _of_files(config: BenchConfig, last: StandData) -> Iterator[Drift]:
    seen = set()
    for part in config.stand_drives:
        known = last.nodes.get(part.name)
        before = None if known is None else last.eds.get(known.eds)
        pair = (str(part.node.eds), None if known is None else known.eds)
        if before is None or pair in seen:
            continue
        seen.add(pair)
        now = eds_objects(part.node.eds)
        for name in sorted(now.keys() | before.keys()):
            if now.get(name) != before.get(name):
                by_node = _eds_text(now.get(name)), _eds_text(before.get(name))
                yield Drift("eds", f"{part.node.eds.name}.{name}", "EDS file", by_node[0], by_node[1])


def _eds_text(found: EdsObject | None) -> str:
    if found is None:
        return "not in it"
    mapped = ", can be mapped" if found.mappable else ""
    return f"default {found.default}, type {found.type:04X}h, {found.access}{mapped}"


# -- nodes -----------------------------------------------------------------------------------------------


def _of_node(
    part: Part,
    now: Mapping[Key, bytes | None],
    last: StandData | None,
    *,
    fresh: bool,
    files: Sequence[EdsFile],
) -> Iterator[Drift]:
    if not now:
        yield Drift("missing", part.name, "node", f"no answer from node {part.node.node_id}")
        return
    od = dictionary_of(part)
    known = None if last is None else last.nodes.get(part.name)
    found = {} if known is None else {parse_object(name): _bytes(text) for name, text in known.found.items()}
    written = {} if known is None or fresh else {parse_object(name): _bytes(t) for name, t in known.written.items()}
    for key in sorted(now.keys() | found.keys()):
        by_file = _by_file(part, od, key, now.get(key))
        drift = _against_last(key, now.get(key), found, written) if key in found else None
        if drift is None and by_file is None:
            continue
        kind, before = drift or (_kind(key), None)
        yield Drift(
            kind,
            f"{part.name}.{name_of(key)}",
            _what(od, key),
            text_of(od, key, now.get(key)),
            None if drift is None else text_of(od, key, before),
            by_file,
            dict(_writes(part, od, key, now, files)),
        )


def _bytes(text: str | None) -> bytes | None:
    return None if text is None else bytes.fromhex(text)


def _against_last(
    key: Key, now: bytes | None, found: Mapping[Key, bytes | None], written: Mapping[Key, bytes | None]
) -> tuple[Kind, bytes | None] | None:
    """Kind of change and the last value, if it is neither what the last run left nor, of an object that it did not
    write, what it found."""
    left = written.get(key, found.get(key))
    if now == left:
        return None
    if key in written and now == found.get(key):
        return "reset", left
    return _kind(key), left


def _kind(key: Key) -> Kind:
    if key[0] in _DEVICE:
        return "identity"
    if key[0] in UNITS:
        return "units"
    return "pdo" if key[0] in _PDO else "parameter"


def _variable(od: ObjectDictionary, key: Key) -> ODVariable | None:
    try:
        return eds.variable(od, *key)
    except KeyError:
        return None


def _what(od: ObjectDictionary, key: Key) -> str:
    variable = _variable(od, key)
    if variable is None:
        return "object"
    parent = getattr(variable.parent, "name", "")
    return f"{parent}, {variable.name}" if parent and key[1] else str(variable.name)


def _by_file(part: Part, od: ObjectDictionary, key: Key, now: bytes | None) -> str | None:
    """Value in the file, where a device must agree with it and does not."""
    variable, mask = _variable(od, key), dict(_BY_THE_FILE).get(key)
    default = None if variable is None else part.node.writes.get(key, variable.default)
    if variable is None or not isinstance(default, int | float) or (mask is not None and not default):
        return None  # the file leaves it open
    if now is None:
        return str(default) if key[0] in UNITS and variable.default is not None else None
    if mask is not None:
        agrees = int.from_bytes(now, "little") & mask == int(default) & mask
    elif key[0] in UNITS:
        agrees = now == _encoded(variable.data_type, default)
    else:
        return None
    return None if agrees else text_of(od, key, _encoded(variable.data_type, default))


def _encoded(kind: int | None, value: int | float) -> bytes | None:
    try:
        return data_type(kind or 0).encode(value)
    except ValueError:
        return None


# -- what the config could say instead -------------------------------------------------------------------


def _writes(
    part: Part,
    od: ObjectDictionary,
    key: Key,
    now: Mapping[Key, bytes | None],
    files: Sequence[EdsFile],
) -> Iterator[Write]:
    if key[0] in (0x1000, 0x1018):
        yield from _other_file(part, now, files)
    elif key[0] in UNITS:
        yield from _units(part, od, now)
    elif key in part.node.writes:
        value = _value(od, key, now.get(key))
        if value is not None:
            name = next(name for name in part.node.parameters if parse_object(name) == key)
            yield (*part.location, "parameters", name), value


def _value(od: ObjectDictionary, key: Key, data: bytes | None) -> int | float | None:
    variable, found = _variable(od, key), None
    with suppress(ValueError):
        found = None if data is None or variable is None else data_type(variable.data_type or 0).decode(data)
    return found if isinstance(found, int | float) else None


def _other_file(part: Part, now: Mapping[Key, bytes | None], files: Sequence[EdsFile]) -> Iterator[Write]:
    answers = [now.get((0x1018, sub)) for sub in (1, 2, 3)]
    identity = tuple(None if answer is None else int.from_bytes(answer, "little") for answer in answers)
    found = fitting(sorted(files, key=lambda file: file.path), identity)
    if found and found[0].path != part.node.eds:
        yield (*part.location, "eds"), str(found[0].path)


def _units(part: Part, od: ObjectDictionary, now: Mapping[Key, bytes | None]) -> Iterator[Write]:
    """The factors that differ from those by file and config; of a device that has them in objects."""

    def read(index: int, sub: int) -> int | float | None:
        key = object_of(part.node_axis, index), sub
        return _value(od, key, now.get(key))

    try:
        there, declared = DriveUnits.from_objects(read, None, part.name), declared_units(part)
    except UnusableInputError:
        return
    for name, found, expected in (
        ("position_rad", there.position_rad, declared.position_rad),
        ("velocity_rad_s", there.velocity_rad_s, declared.velocity_rad_s),
        ("rated_torque_Nm", 1000.0 * there.torque_Nm, 1000.0 * declared.torque_Nm),
    ):
        if not isclose(found, expected, rel_tol=1e-9):
            yield (*part.location, "units", name), found
