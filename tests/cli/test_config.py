"""`hilbench config`: the schema that editors use, and a new bench."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import jsonschema
import pytest
from tests.cli.in_process import hilbench

from hilbench import strict_yaml
from hilbench.runs.config import load
from hilbench.runs.config_text import json_schema

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted((ROOT / "bench_configs").glob("*.yaml"))


@pytest.fixture(scope="module")
def validator() -> jsonschema.Draft202012Validator:
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_schema_takes_what_is_shipped_and_no_misspelt_key(path, validator):
    data = strict_yaml.load(path).data
    assert list(validator.iter_errors(data)) == []
    assert list(validator.iter_errors({**data, "tension_contrl": {}}))


def test_a_file_that_includes_nothing_is_complete(validator):
    data = strict_yaml.load(ROOT / "bench_configs" / "web_section_step.yaml").data
    without = {key: value for key, value in data.items() if key != "drives"}
    assert list(validator.iter_errors(without))
    assert not list(validator.iter_errors({**without, "include": "base.yaml"}))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_key_of_a_shipped_config_says_what_it_is(path):
    silent = {"name", "description"}
    for line in path.read_text(encoding="utf-8").splitlines():
        key = line.strip().partition(":")[0]
        one_line_node = line.startswith("  ") and "{node_id:" in line
        if line.strip() and not line.strip().startswith(("#", "-")) and key not in silent and not one_line_node:
            assert "#" in line, f"{key} has no comment"


def test_check_says_all_that_is_wrong_with_a_config_each_with_its_place(tmp_path):
    path = tmp_path / "bench.yaml"
    path.write_text(
        f"include: {ROOT / 'bench_configs' / 'web_section_step.yaml'}\n"
        "controllers: {tension_control: {setpoint_N: 90}}\n"
        "machine: {web: {width_m: wide}}\n"
        "steps:\n"
        "  - ramp: {path: line_sped_m_s, to: 2, duration_s: 1}\n"
        "  - wait_until: {condition: v2_ms > 1, timeout_s: 1}\n"
        "criteria:\n"
        "  - {name: a, metric: E_time_to_1pc_s, max: 1}\n"
    )
    done = hilbench("check", path, "--set", "pce=lockstep")
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    expected = [
        ("hilbench: --set pce=lockstep: ", "'pace'"),
        (f"hilbench: {path}:2: ", "'controllers.tension_control.set_point_N'"),
        (f"hilbench: {path}:3: ", None),
        (f"hilbench: {path}:5: ", "'line_speed_m_s'"),
        (f"hilbench: {path}:6: ", "'v2_m_s'"),
        (f"hilbench: {path}:8: ", "'E_time_to_1pct_s'"),
    ]
    assert len(lines) == len(expected)
    for line, (place, meant) in zip(lines, expected, strict=True):
        assert line.startswith(place)
        assert meant is None or f"did you mean {meant}?" in line


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("drives.axis3.eds=x.eds", "--set drives.axis3.eds=x.eds: 'drives.axis3.node_id' is missing"),
        ("twin.estimate.0.method=kalmn", "expected: 'method' as one of 'pid', 'rls', "),
    ],
)
def test_an_option_that_is_wrong_is_named_with_what_was_expected(change, said):
    done = hilbench("check", ROOT / "bench_configs" / "web_section_step.yaml", "--set", change)
    assert done.returncode == 2
    assert said in done.stderr


def test_a_table_that_is_not_there_is_named_with_what_is_expected(tmp_path):
    done = hilbench(
        "check", ROOT / "bench_configs" / "web_section_step.yaml", "--set", "steps=[{table: {file: nowhere.csv}}]"
    )
    assert done.returncode == 2
    assert done.stderr.endswith("nowhere.csv', expected: a file that is there\n")


def test_a_config_in_a_folder_whose_name_is_no_utf_8_is_refused_before_the_run(tmp_path):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/odd-\xff"))
    folder.mkdir()
    (folder / "bench.yaml").write_text("{}")
    done = hilbench("run", folder / "bench.yaml", "--in-process")
    assert done.returncode == 2
    assert done.stderr.endswith("bench.yaml: the path is not UTF-8 text, expected one\n")


def test_check_names_every_eds_file_that_is_not_there(tmp_path):
    shipped = ROOT / "bench_configs" / "web_section_step.yaml"
    changes = ["--set", "drives.axis1.eds=nowhere.eds", "--set", "load_motors.load.eds=away.eds"]
    done = hilbench("check", shipped, *changes)
    assert done.returncode == 2
    assert [line.partition(": ")[2].partition(": ")[0] for line in done.stderr.splitlines()] == [
        f"--set {change}" for change in changes[1::2]
    ]


def test_new_asks_and_writes_a_bench_that_can_be_run(tmp_path):
    path = tmp_path / "mine.yaml"
    answers = "mine\nembedded:mine\n" + "\n" * 3 + "4e9\n" + "\n" * 20
    done = hilbench("config", "new", path, "--eds", ROOT / "eds", typed=answers)
    assert done.returncode == 0, done.stderr
    config, _ = load(path)
    assert (config.name, config.bus.address, config.machine.required_web.youngs_modulus_Pa) == (
        "mine",
        "embedded:mine",
        4e9,
    )
    assert "# of the closed tension loop" in path.read_text()
    again = hilbench("config", "new", path, "--defaults", "--eds", ROOT / "eds")
    assert again.returncode == 2
    assert "is there already" in again.stderr


def test_new_asks_its_way_to_a_machine_of_another_kind(tmp_path):
    path = tmp_path / "shaft.yaml"
    typed = "mine\nembedded:mine\n" + "\n" * 3 + "0.06\n" + "\n" * 20
    done = hilbench("config", "new", path, "--kind", "servo_axis", "--eds", ROOT / "eds", typed=typed)
    assert done.returncode == 0, done.stderr
    config, _ = load(path)
    assert (config.machine.kind, config.machine.shaft.inertia_kg_m2) == ("servo_axis", 0.06)
    checked = hilbench("check", path)
    assert checked.returncode == 0, checked.stderr
    assert "line_speed" not in path.read_text()


def test_new_suggests_sizes_that_fit_the_answers_before_and_its_bench_passes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # without EDS files: they are copied
    # An 80 mm roller of a web 0.3 m wide, at 1.5 m/s and 30 N.
    answers = ["mine", *4 * [""], "", "0.3", "30e-6", "", "1.5", "30", "0.08", *12 * [""]]
    done = hilbench("config", "new", "mine.yaml", typed="\n".join(answers) + "\n")
    assert done.returncode == 0, done.stderr
    machine = load(tmp_path / "mine.yaml")[0].machine
    # A tube goes with r³ and the width: 1.167 · (0.08 / 0.2)³ · 0.3 / 0.5 kg·m²; the motor is as fast as before.
    assert machine.rollers.inertia_kg_m2 == pytest.approx(0.0448, rel=0.01)
    assert machine.rollers.gear_ratio == pytest.approx(4.0)
    assert machine.boundary.upstream_tension_N == 30.0
    assert sorted(path.name for path in (tmp_path / "eds").iterdir()) == [
        "hilbench_servo.eds",
        "hilbench_virtual_io.eds",
    ]
    ran = hilbench("run", "mine.yaml", "--in-process", "--no-report")
    assert ran.returncode == 0, ran.stdout


def test_new_asks_again_for_an_answer_that_cannot_be_used(tmp_path):
    path = tmp_path / "mine.yaml"
    # An empty line takes what is suggested: here the answers that went before the refused ones.
    answers = [
        "a b",
        "mine",
        "socketcn",
        "embedded:mine",
        "5",
        "",
        "slow",
        "lockstep",
        "-1",
        "",
        "0",
        "4e9",
        *14 * [""],
    ]
    done = hilbench("config", "new", path, "--eds", ROOT / "eds", typed="\n".join(answers) + "\n")
    assert done.returncode == 0, done.stderr
    refused = [line.partition("' is ")[2].partition(",")[0] for line in done.stderr.splitlines()]
    assert refused == ["'a b'", "'socketcn'", "5", "'slow'", "-1.0", "0.0"]
    config, _ = load(path)
    assert (config.name, config.bus.bitrate, config.machine.required_web.youngs_modulus_Pa) == ("mine", 1_000_000, 4e9)


def test_new_keeps_the_answers_when_they_do_not_go_together(tmp_path):
    path = tmp_path / "mine.yaml"
    too_fast = ["mine", "embedded:mine", "125000", *17 * [""]]
    done = hilbench(
        "config", "new", path, "--eds", ROOT / "eds", typed="\n".join([*too_fast, "", "", "1000000", *18 * [""]])
    )
    assert done.returncode == 0, done.stderr
    assert "bit times" in done.stderr
    assert load(path)[0].bus.address == "embedded:mine"


@pytest.mark.parametrize(
    ("place", "words"),
    [("no folder", ["nowhere/mine.yaml", "--eds", "eds"]), ("--eds: no file", ["mine.yaml", "--eds", "nowhere"])],
)
def test_new_says_what_cannot_work_before_it_asks(tmp_path, monkeypatch, place, words):
    monkeypatch.chdir(tmp_path)
    done = hilbench("config", "new", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert place in done.stderr


def test_new_without_answers_is_unusable_input_and_ctrl_c_is_an_interruption(tmp_path):
    words = ["config", "new", tmp_path / "mine.yaml", "--eds", ROOT / "eds"]
    done = hilbench(*words, typed="mine\n")
    assert done.returncode == 2
    assert "ended at the question 'bus" in done.stderr
    command = [sys.executable, "-m", "hilbench", *map(str, words)]
    asking = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert asking.stdout is not None
    assert asking.stdout.read(4) == b"name"
    asking.send_signal(signal.SIGINT)
    _, err = asking.communicate(timeout=30)
    assert (asking.returncode, err) == (130, b"hilbench: interrupted\n")
    assert not (tmp_path / "mine.yaml").exists()
