"""Drift of a stand's data: each change of a node, a file or the config since the last run is found, nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.cli.in_process import hilbench

from hilbench.apps.doctor.drift import Drift, NodeAnswers, drifts
from hilbench.apps.doctor.drive_answers import LastRun, last_run
from hilbench.bench.lifecycle.in_process import InProcess
from hilbench.bench.lifecycle.participants import Participants
from hilbench.canopen.sdo_client import SdoClient
from hilbench.exchange.node_data import ask_all
from hilbench.results.run import run_experiment
from hilbench.runs.config import ExperimentConfig, load, load_with_overrides
from hilbench.topology.parts import parse_object

ROOT = Path(__file__).resolve().parents[2]
EDS = ROOT / "eds" / "hilbench_servo.eds"
CHANGES = 50
PARTS = ("axis1", "axis2", "load")

#: What may be another on a device: kind, object, its values.
OF_DEVICES: tuple[tuple[str, str, tuple[object, ...]], ...] = (
    ("identity", "1000h", ("0x00030192", "0x00020195")),
    ("identity", "1008h", ("other servo",)),
    ("identity", "1009h", ("B2",)),
    ("identity", "100Ah", ("1.1", "2.0")),
    ("identity", "1018h:1", ("0x2E1",)),
    ("identity", "1018h:2", ("0x999",)),
    ("identity", "1018h:3", ("0x00010001", "0x00020000")),
    ("identity", "1018h:4", ("4711",)),
    ("units", "608Fh:1", ("65536", "2097152")),
    ("units", "608Fh:2", ("2",)),
    ("units", "6091h:1", ("3",)),
    ("units", "6091h:2", ("7",)),
    ("units", "60A9h", ("0xFDB44700", "0x00B44700")),
    ("units", "6076h", ("2500", "7000")),
    ("parameter", "6085h", ("1000000", "123")),
    ("parameter", "605Ah", ("6", "1")),
    ("parameter", "6007h", ("2", "0")),
    ("pdo", "1600h:2", ("0x60710010",)),
    ("pdo", "1A00h:2", ("0x60410010",)),
    ("pdo", "1A00h:3", ("0x606C0020",)),
    ("pdo", "1800h:2", ("254",)),
)
OF_FILES = ("6085h", "6076h", "608Fh:1", "1018h:3", "605Ah", "60A9h", "1017h")
OF_CONFIGS = (
    ("machine.web.width_m", "0.6"),
    ("machine.rollers.inertia_kg_m2", "1.2"),
    ("drives.axis1.parameters.605Eh", "1"),
    ("drives.axis2.units.rated_torque_Nm", "4.0"),
    ("master.node_heartbeat_ms", "200"),
    ("safety.quick_stop_m_s2", "2.0"),
    ("controllers.tension_control.set_point_N", "90.0"),
    ("mirroring", "copy"),
)
#: What the bench writes into a drive with another value than it has after power-on.
WRITTEN = ("6085h", "6007h", "1017h", "1016h:1")


def with_defaults(source: Path, target: Path, defaults: Mapping[str, object]) -> Path:
    """An EDS file with other default values, by object as messages name it."""
    text = source.read_text()
    for name, value in defaults.items():
        index, _, sub = name.partition(":")
        head = index.removesuffix("h").upper() + (f"sub{int(sub):X}" if sub else "")
        section = re.search(rf"(?ims)^\[{head}\]$.*?(?=^\[|\Z)", text)
        if section is None:  # an array or record: its number of entries
            raise KeyError(name)
        if "ObjectType=0x7" not in section[0] and not sub:
            section = re.search(rf"(?ims)^\[{head}sub0\]$.*?(?=^\[|\Z)", text)
            assert section is not None
        changed, count = re.subn(r"(?m)^DefaultValue=.*$", f"DefaultValue={value}", section[0])
        assert count == 1, name
        text = text.replace(section[0], changed)
    target.write_text(text)
    return target


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stand with an EDS file of its own for each drive, and a run."""
    made = tmp_path_factory.mktemp("drift")
    for part in PARTS:
        (made / f"{part}.eds").write_text(EDS.read_text())
    axes = {axis: {"eds": f"{axis}.eds"} for axis in ("axis1", "axis2")}
    own = {
        "include": str(ROOT / "bench_configs" / "web_section_step.yaml"),
        "drives": axes,
        "load_motors": {"load": {"eds": "load.eds"}},
        "steps": [{"hold": {"duration_s": 0.05}}],
        "criteria": [],
    }
    (made / "line.yaml").write_text("# of the stand\n" + yaml.safe_dump(own))
    run_experiment(load_with_overrides(made / "line.yaml"), made / "runs", participants=Participants.IN_PROCESS)
    return made


@pytest.fixture(scope="module")
def last(folder: Path) -> LastRun:
    found, problems = last_run(folder / "runs", "web_section_step")
    assert problems == []
    assert found is not None
    return found


def said_by(config: ExperimentConfig) -> NodeAnswers:
    """What simulated drives with the EDS files of a config say."""
    here = InProcess(config)
    here.boot()
    with SdoClient(here.open_python_can(), 1.0) as reader:
        return ask_all(reader, config)


@pytest.fixture(scope="module")
def usual(folder: Path) -> NodeAnswers:
    return said_by(load(folder / "line.yaml")[0])


def device(folder: Path, scratch: Path, part: str, defaults: Mapping[str, object]) -> NodeAnswers:
    """What the drives say when one is another device: its objects have other values after power-on."""
    group = "load_motors" if part == "load" else "drives"
    eds = with_defaults(folder / f"{part}.eds", scratch / "device.eds", defaults)
    return said_by(load_with_overrides(folder / "line.yaml", changes=[f"{group}.{part}.eds={eds}"]).config)


def found_in(
    folder: Path, last: LastRun, said: NodeAnswers, *, fresh: bool = True, changes: tuple[str, ...] = ()
) -> list[Drift]:
    config = load_with_overrides(folder / "line.yaml", changes=changes).config
    return drifts(config, said, last.data, last.config, fresh=frozenset(PARTS if fresh else ()))


def as_left(said: NodeAnswers, last: LastRun) -> dict[str, dict[tuple[int, int], bytes | None]]:
    """The drives as the last run has left them: not restarted since."""
    left = {part: dict(objects) for part, objects in said.items()}
    for part, objects in left.items():
        written = {parse_object(name): bytes.fromhex(text) for name, text in last.data.nodes[part].written.items()}
        objects.update({key: written[key] for key in objects if key in written})
    return left


def test_nothing_has_drifted_where_nothing_was_changed(folder: Path, last: LastRun, usual: NodeAnswers) -> None:
    assert found_in(folder, last, usual) == []
    assert found_in(folder, last, as_left(usual, last), fresh=False) == []


def seeded() -> Iterator[tuple[int, str]]:
    kinds = ("device", "device", "device", "file", "config", "reset", "silent")
    for seed in range(CHANGES):
        yield seed, kinds[seed % len(kinds)]


@pytest.mark.parametrize(("seed", "kind"), list(seeded()))
def test_each_change_is_found_and_nothing_else(
    seed: int, kind: str, folder: Path, last: LastRun, usual: NodeAnswers, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    part = str(rng.choice(PARTS))
    if kind == "device":
        what, name, values = OF_DEVICES[(seed - seed // 7 * 4) % len(OF_DEVICES)]
        name = "1600h:1" if name == "1600h:2" and part == "load" else name
        said = device(folder, tmp_path, part, {name: values[int(rng.integers(len(values)))]})
        (found,) = found_in(folder, last, said)
        assert (found.kind, found.key) == (what, f"{part}.{name}")
        assert found.last_run is not None
    elif kind == "file":
        name, file = str(rng.choice(OF_FILES)), folder / f"{part}.eds"
        before = file.read_text()
        try:
            with_defaults(file, file, {name: 77})
            found = found_in(folder, last, usual)
        finally:
            file.write_text(before)
        assert ("eds", f"{part}.eds.{name}") in [(each.kind, each.key) for each in found]
        # A drive that does not say what its file says is told as well.
        assert {each.key for each in found} <= {f"{part}.eds.{name}", f"{part}.{name}"}
    elif kind == "config":
        key, value = OF_CONFIGS[int(rng.integers(len(OF_CONFIGS)))]
        found = found_in(folder, last, usual, changes=(f"{key}={value}",))
        assert [(each.kind, each.key) for each in found if each.kind == "config"] == [("config", key)]
    elif kind == "reset":
        key = parse_object(str(rng.choice(WRITTEN)))
        left = as_left(usual, last)
        left[part][key] = usual[part][key]
        (reset,) = found_in(folder, last, left, fresh=False)
        assert (reset.kind, reset.key) == ("reset", f"{part}.{key[0]:04X}h" + (f":{key[1]}" if key[1] else ""))
    else:
        (missing,) = found_in(folder, last, {**usual, part: {}})
        assert (missing.kind, missing.key) == ("missing", part)


def test_without_a_run_drives_are_compared_with_their_files(folder: Path, tmp_path: Path) -> None:
    config = load(folder / "line.yaml")[0]
    said = device(folder, tmp_path, "axis2", {"608Fh:1": 65536, "1018h:2": 0x999, "6085h": 5})
    found = drifts(config, said, None, None, fresh=frozenset())
    assert {each.key for each in found} == {"axis2.608Fh:1", "axis2.1018h:2"}
    assert all(each.eds is not None and each.last_run is None for each in found)


def drift(folder: Path, *words: str, code: int) -> str:
    done = hilbench("drift", folder / "line.yaml", "--in-process", "--runs", folder / "runs", *words)
    assert done.returncode == code, done
    return done.stdout + done.stderr


def test_the_command_says_with_its_exit_code_whether_something_has_drifted(folder: Path, last: LastRun) -> None:
    assert "nothing has drifted" in drift(folder, code=0)
    shown = json.loads(drift(folder, "--set", "machine.web.width_m=0.6", "--json", code=1))
    assert shown["last_run"] == str(last.folder.path)
    (found,) = shown["drifts"]
    assert (found["key"], found["now"], found["last_run"]) == ("machine.web.width_m", "0.6", "0.5")


def test_what_can_not_be_written_is_refused(folder: Path, last: LastRun) -> None:
    refused = drift(folder, "--write", "axis1.100Ah", code=2)
    assert "'axis1.100Ah' is nothing that can be written, expected one of: none, all" in refused


def test_what_a_node_says_is_written_into_the_config_on_request(
    folder: Path, last: LastRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = folder / "line.yaml"
    before = config.read_text()
    said = device(folder, tmp_path, "axis2", {"6076h": 2500, "1008h": "other"})
    monkeypatch.setattr("hilbench.apps.doctor.drive_answers.read_stand", lambda config, **_: (said, frozenset(PARTS)))
    try:
        shown = json.loads(drift(folder, "--write", "axis2.6076h", "--json", code=1))
        assert {each["key"] for each in shown["drifts"]} == {"axis2.6076h", "axis2.1008h"}
        assert load(config)[0].drives["axis2"].units.rated_torque_Nm == 2.5
        assert config.read_text().startswith("# of the stand\n")
        assert len(config.read_text().splitlines()) == len(before.splitlines()) + 1
        assert shown["written"] == [f"{config}: drives.axis2.units.rated_torque_Nm is 2.5 now"]
    finally:
        config.write_text(before)


def test_an_exchanged_device_gets_its_eds_file(
    folder: Path, last: LastRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = folder / "line.yaml"
    before = config.read_text()
    said = device(folder, tmp_path, "load", {"1018h:2": "0x999"})
    other = with_defaults(EDS, folder / "other.eds", {"1018h:2": "0x999"})
    other.write_text(re.sub(r"(?m)^ProductNumber=.*$", "ProductNumber=0x999", other.read_text()))
    monkeypatch.setattr("hilbench.apps.doctor.drive_answers.read_stand", lambda config, **_: (said, frozenset(PARTS)))
    try:
        drift(folder, "--write", "all", code=1)
        assert "eds: other.eds" in config.read_text()
        assert load(config)[0].load_motors["load"].eds == other
    finally:
        config.write_text(before)
        other.unlink()
