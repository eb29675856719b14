"""Every command line that the docs show is run: in this process, on the shipped configs with shorter steps.

Simulated hardware and twin are started once, by the lines that the docs show for it; the bench uses them.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.diagnosis.axis_rig import Rig
from tests.docs.shown import ROOT, shown
from tests.simulated_recordings import hidden_recording
from typer.testing import CliRunner

from hilbench.apps.cli.main import command_line
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.listening import present
from hilbench.plant.model_file import write_model
from hilbench.plant.parameters import EffectEntry
from hilbench.results.recording import write_recording
from hilbench.runs.config import load

pytestmark = pytest.mark.docs

#: As long as the shipped ones in what they do, not in time; the third is the step that the tutorial changes.
STEPS = [
    {"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 0.6}},
    {"hold": {"until_s": 1.5}},
    {"step": {"path": "load.web.youngs_modulus_Pa", "to": 10.5e9}},
    {"hold": {"duration_s": 1.6}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.6}},
]
#: Enough for a diagnosis: two speeds and two tensions.
LONGER_STEPS = [
    {"ramp": {"path": "line_speed_m_s", "to": 1.5, "duration_s": 1.5}},
    {"hold": {"duration_s": 3.0}},
    {"set": {"path": "tension_control.set_point_N", "to": 100.0}},
    {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 1.5}},
    {"hold": {"duration_s": 3.0}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 2.0}},
]
#: The bench that starts its own processes, on a bus of its own; and what a diagnosis makes of it.
_OWN = "hidden_friction"
_EXTENDED = "found/config_extended.yaml"
#: The folder of a run that is long enough for a diagnosis.
_LONG_ENOUGH = "diagnosed/RUN"
#: What costs too much of these.
_SHORTER = {"2..10:5": "2..10:2", "seed=1,2,3": "seed=1", "20": "1"}
#: The bus of the stand, in a line.
_BUS = "embedded"


def as_it_is_run(words: tuple[str, ...]) -> tuple[str, ...]:
    """On the stand's bus, in lockstep, with the processes that run already; less of what is repeated."""
    done = [_SHORTER.get(word, word).replace("2..10:5", "2..10:2") for word in words]
    if "--pace" in done:
        del done[done.index("--pace") : done.index("--pace") + 2]
    own = any(_OWN in word or word == _EXTENDED for word in words)
    if words[0] in ("run", "doctor") and not own and "--in-process" not in words:
        done = [word for word in done if word != "--no-start"] + ["--no-start"]
        if any(word.endswith(".yaml") for word in words) and "--bus" in done:  # it is the config's
            del done[done.index("--bus") : done.index("--bus") + 2]
    if words[0] in ("drive", "scan", "sdo") and not {"--bus", "--config"} & set(words):
        done += ["--bus", _BUS]
    if words[0] == "diagnose":
        done = [word.replace("runs/RUN/recording.mf4", "blind.mf4") for word in done]
        done = [_LONG_ENOUGH if word == "runs/RUN" else word for word in done]
    return tuple(done)


def different(lines: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """One of those that differ in what they write to only."""
    found = {}
    for words in lines:
        at = words.index("--out") if "--out" in words else len(words)
        found[words[:at] + words[at + 2 :]] = words
    return sorted(found.values())


LINES = different([as_it_is_run(line.words) for line in shown() if line.words])


@dataclass(frozen=True)
class Stand:
    """A folder with what the lines name, and the bus on which simulated hardware and twin run."""

    folder: Path
    bus: str
    children: list[subprocess.Popen[bytes]]


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stand]:
    folder = tmp_path_factory.mktemp("docs")
    bus = f"embedded:docs{uuid.uuid4().hex[:8]}"
    (folder / "eds").symlink_to(ROOT / "eds")
    (folder / "bench_configs").mkdir()
    for name, steps, at in (("web_section_step", STEPS, bus), (_OWN, LONGER_STEPS, f"{bus}own")):
        shorter = {"include": str(ROOT / "bench_configs" / f"{name}.yaml"), "bus": {"address": at}}
        path = folder / "bench_configs" / f"{name}.yaml"
        path.write_text(yaml.safe_dump({**shorter, "steps": steps, "criteria": []}))
    model = load(folder / "bench_configs" / "web_section_step.yaml")[0].machine
    write_model(folder / "model.yaml", model)
    friction = EffectEntry(effect="coulomb_friction", axis=2, parameters={"force_N": 4.2})
    write_recording(hidden_recording(model, [friction], duration_s=12.0), folder / "blind.mf4")
    (folder / _LONG_ENOUGH).mkdir(parents=True)
    shutil.copy(folder / "blind.mf4", folder / _LONG_ENOUGH / "recording.mf4")
    shutil.copy(folder / "bench_configs" / "web_section_step.yaml", folder / _LONG_ENOUGH / "config.yaml")
    for name, coulomb_Nm in (("before", 0.03), ("after", 0.04)):
        write_recording(Rig(coulomb_Nm=coulomb_Nm).recordings(1)[0], folder / f"{name}.csv")
    (folder / "machine.csv").write_text("Zeit;M2\n0;1,5\n2;1,6\n4;1,4\n")
    columns = {"file": {"delimiter": ";", "decimal": ","}}
    columns["channels"] = {"t_s": {"column": "Zeit", "factor": "0.001"}, "tau2_Nm": "M2"}
    (folder / "columns.yaml").write_text(yaml.safe_dump(columns).replace("'0.001'", "0.001"))
    paced = ["--pace", "lockstep"]  # as the config: a bench waits for them
    started = [
        [sys.executable, "-m", "hilbench", command, "bench_configs/web_section_step.yaml", "--bus", bus, *paced]
        for command in ("simulate-hardware", "twin")
    ]
    children = [subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL) for command in started]
    try:
        wait_for_nodes(bus, children)
        yield Stand(folder, bus, children)
    finally:
        for child in children:
            child.terminate()
            child.wait(timeout=30)


def wait_for_nodes(bus: str, children: list[subprocess.Popen[bytes]]) -> None:
    link = open_link(BusAddress.parse(bus, timing="virtual"))
    try:
        while len(present(link, [2, 17, 32], 0.2)) < 3:
            assert all(child.poll() is None for child in children)
    finally:
        link.close()


@pytest.fixture(scope="module")
def run_folder(stand: Stand) -> Path:
    """What a run leaves, under the name that the docs give it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(stand.folder)
        hilbench("run", "bench_configs/web_section_step.yaml", "--no-start", "--out", "first")
    (stand.folder / "runs").mkdir()
    return next((stand.folder / "first").iterdir()).rename(stand.folder / "runs" / "RUN")


def hilbench(*words: str) -> None:
    result = CliRunner().invoke(command_line(words[0]), list(words), input="\n" * 40)
    # The commands before may have changed something on the stand.
    assert result.exit_code in ((0, 1) if words[0] == "drift" else (0,)), f"{result.output}\n{result.exception!r}"


@pytest.mark.parametrize("words", LINES, ids=" ".join)
def test_it_does_what_it_says(
    words: tuple[str, ...], stand: Stand, run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(stand.folder)
    if words[0] in ("simulate-hardware", "twin"):
        assert all(child.poll() is None for child in stand.children)
        return
    if words[0] == "recover":
        cut_off = shutil.copytree(run_folder, stand.folder / "cut_off")
        (cut_off / "recording.mf4").unlink()
        words = ("recover", "cut_off")
    if words[0] == "sweep":
        words += ("--out", str(tmp_path / "sweep"))
    if words[:2] == ("check", "my_bench.yaml") and not Path("my_bench.yaml").exists():
        hilbench("config", "new", "my_bench.yaml")
    if _EXTENDED in words and not Path(_EXTENDED).exists():
        hilbench("diagnose", f"bench_configs/{_OWN}.yaml", "--out", "found")
    if words[:2] == ("config", "new"):
        Path(words[2]).unlink(missing_ok=True)
    # A trace goes onto another bus: on this one somebody would answer.
    bus = f"{stand.bus}r" if words[0] == "replay" else stand.bus
    hilbench(*(bus if word == _BUS else word for word in words))


@pytest.mark.parametrize("page", ["tutorial", "scripts"])
def test_what_is_read_of_a_recording_in_python_is_a_plot(
    page: str, run_folder: Path, stand: Stand, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / f"{page}.md").read_text(), flags=re.DOTALL)
    (code,) = (block for block in blocks if "read_recording" in block)
    monkeypatch.chdir(stand.folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, Any] = {}
    exec(code, names)
    assert len(names["signals"]) > 100
