"""`hilbench sync` as a user starts it."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.cli.in_process import hilbench
from tests.estimation.runs import NEW_PA, Array, measured, stepped, tracked
from tests.plant.models import DEMONSTRATOR, model

from hilbench.apps.sync.compare import rows
from hilbench.errors import UnusableInputError
from hilbench.estimation.web_line.config import METHODS
from hilbench.estimation.web_line.offline import Track, run_offline
from hilbench.results.recording import Recording, read_recording, write_recording
from hilbench.results.web_line_synchronization import (
    NEEDED,
    compare_methods,
    compare_runs,
    estimates,
    measurements_of,
    twin_config,
)

COLUMNS = "t_s,v1_cmd_m_s,v2_cmd_m_s,x1_m,x2_m,tau2_Nm,strain_prev,F_next_N,E_true_Pa"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording with a step of E, and the model without it."""
    folder = tmp_path_factory.mktemp("sync")
    true = stepped(7.0)
    data = measured(true, seed=5)
    table = np.column_stack([data.t_s, data.v_cmd_m_s, data.x_m, data.tau2_Nm, data.strain_prev, data.F_next_N, true])
    np.savetxt(folder / "recording.csv", table, delimiter=",", header=COLUMNS, comments="", fmt="%.12g")
    (folder / "model.yaml").write_text(yaml.safe_dump(DEMONSTRATOR))
    return folder / "recording.csv", folder / "model.yaml"


def sync(*arguments: object) -> subprocess.CompletedProcess[str]:
    return hilbench("sync", *arguments)


def test_methods_side_by_side_as_json_and_as_a_page(files: tuple[Path, Path], tmp_path: Path) -> None:
    recording, model = files
    done = sync(recording, "--model", model, "--method", "pid,changepoint", "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    found = {result["method"]: result for result in data["methods"]}
    assert list(found) == ["pid", "changepoint"]
    assert data["step_s"] == pytest.approx(3.0)
    assert data["torque_noise_Nm"] == pytest.approx(0.05, rel=0.05)
    assert found["pid"]["time_to_1pct_s"] is None
    assert 0.0 < data["bound"]["time_to_1pct_s"] < found["changepoint"]["time_to_1pct_s"] < 0.2
    assert found["changepoint"]["final_E_Pa"] == pytest.approx(NEW_PA, rel=2e-3)
    page = (tmp_path / "out" / "sync.html").read_text()
    assert "changepoint" in page
    assert page.count("<svg") == 3  # all methods, each with its interval, around the step
    assert 'href="estimates.csv"' in page


@pytest.mark.parametrize("suffix", [".csv.gz", ".mf4"])
def test_estimates_over_time_are_those_of_the_methods_in_every_row(
    files: tuple[Path, Path], tmp_path: Path, suffix: str
) -> None:
    recording, path = tmp_path / f"recording{suffix}", files[1]
    write_recording(read_recording(files[0]), recording)
    done = sync(recording, "--model", path, "--method", "rls,ekf", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "estimates.csv" in done.stdout
    header = (tmp_path / "out" / "estimates.csv").read_text().split("\n", 1)[0]
    assert header == "t_s,rls_E_Pa,rls_E_sd_Pa,ekf_E_Pa,ekf_E_sd_Pa"
    written, source = read_recording(tmp_path / "out" / "estimates.csv"), read_recording(recording)
    assert written.time_s.tolist() == source.time_s.tolist()
    data = measurements_of(source, recording)
    for name in ("rls", "ekf"):
        track = run_offline(model(), twin_config(METHODS[name]()), data)
        assert written[f"{name}_E_Pa"].tolist() == track.E_Pa.tolist()
        assert written[f"{name}_E_sd_Pa"].tolist() == track.E_sd_Pa.tolist()


def test_estimates_of_a_recording_of_another_cycle_have_its_rows(files: tuple[Path, Path], tmp_path: Path) -> None:
    path = files[1]
    source = read_recording(files[0])
    thinned = Recording({name: values[:1000:3] for name, values in source.channels.items()})  # 6 ms
    write_recording(thinned, tmp_path / "thinned.csv")
    done = sync(tmp_path / "thinned.csv", "--model", path, "--method", "rls", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert read_recording(tmp_path / "estimates.csv").time_s.tolist() == thinned.time_s.tolist()


def test_a_line_of_several_spans_is_refused(tmp_path: Path, files: tuple[Path, Path]) -> None:
    config = Path(__file__).resolve().parents[2] / "bench_configs" / "line_two_spans.yaml"
    for arguments in ([files[0], "--model", config], [config]):
        done = sync(*arguments, "--out", tmp_path / "out")
        assert done.returncode == 2
        assert "a line of 3 rollers, expected one of two, with one span" in done.stderr
        assert not (tmp_path / "out").exists()


def test_a_recording_of_a_clock_that_drifts_and_was_set_with_rows_missing(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    recording, model = files
    table = np.loadtxt(recording, delimiter=",", skiprows=1)
    table[:, 0] *= 1.0002
    table[2500:, 0] += 0.05
    table = np.delete(table, slice(2700, 2725), axis=0)
    np.savetxt(tmp_path / "other.csv", table, delimiter=",", header=COLUMNS, comments="", fmt="%.12g")
    done = sync(tmp_path / "other.csv", "--model", model, "--method", "changepoint", "--json")
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)["methods"]
    assert found["time_to_1pct_s"] < 0.12
    assert found["final_E_Pa"] == pytest.approx(NEW_PA, rel=2e-3)
    assert "25 of 3500 cycles have no row" in done.stderr


def test_rows_of_another_cycle_are_said_to_be_brought_to_the_twins(files: tuple[Path, Path], tmp_path: Path) -> None:
    recording, model = files
    table = np.loadtxt(recording, delimiter=",", skiprows=1)
    t_s = np.arange(0.0, table[-1, 0], 0.0033)
    rows = np.column_stack([np.interp(t_s, table[:, 0], column) for column in table.T])
    np.savetxt(tmp_path / "other.csv", rows, delimiter=",", header=COLUMNS, comments="", fmt="%.12g")
    done = sync(tmp_path / "other.csv", "--model", model, "--method", "rls", "--json")
    assert done.returncode == 0, done.stderr
    assert "rows are brought to cycles of 4 ms" in done.stderr


def test_the_stated_deviation_is_what_the_option_allows_for(files: tuple[Path, Path]) -> None:
    recording, model = files
    deviations = []
    for unmodelled in ("0", "0.05"):
        done = sync(recording, "--model", model, "--method", "rls", "--unmodelled-torque", unmodelled, "--json")
        deviations.append(json.loads(done.stdout)["methods"][0]["final_deviation_Pa"])
    added_Pa = float(np.sqrt(deviations[1] ** 2 - deviations[0] ** 2))
    # 0.05 N·m at the motor are 1.25 N at the web, whose tension is between 75 and 97 N.
    assert 1.25 / 97.0 * NEW_PA < added_Pa < 1.25 / 75.0 * NEW_PA


def test_the_table_names_every_method(files: tuple[Path, Path], tmp_path: Path) -> None:
    recording, model = files
    rows = recording.read_text().splitlines(keepends=True)
    (tmp_path / "short.csv").write_text("".join(rows[:1000]))  # 2 s: what they find does not matter here
    done = sync(tmp_path / "short.csv", "--model", model)
    assert done.returncode == 0, done.stderr
    for name in ("pid", "lm", "global", "rls", "ekf", "changepoint"):
        assert name in done.stdout


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--method", "guess"], "'guess', expected some of pid, lm, global, rls, ekf, changepoint, input, or all"),
        (["--out", "{recording}/inside"], "cannot be made"),
    ],
)
def test_what_is_wrong_is_one_line_and_exit_2(files: tuple[Path, Path], options: list[str], said: str) -> None:
    recording, model = files
    done = sync(recording, "--model", model, *[option.format(recording=recording) for option in options])
    assert done.returncode == 2
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_recording_without_the_torque_is_named(files: tuple[Path, Path], tmp_path: Path) -> None:
    recording, model = files
    lines = recording.read_text().splitlines()
    keep = [i for i, name in enumerate(lines[0].split(",")) if name != "tau2_Nm"]
    less = tmp_path / "less.csv"
    less.write_text("\n".join(",".join(line.split(",")[i] for i in keep) for line in lines))
    done = sync(less, "--model", model)
    assert done.returncode == 2
    assert "tau2_Nm" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_recording_needs_a_model(files: tuple[Path, Path]) -> None:
    done = sync(files[0])
    assert done.returncode == 2
    assert "--model" in done.stderr


def test_runs_of_a_bench_are_scored_by_what_their_twins_said() -> None:
    """As a recording's methods are; the bound is that of the samples."""
    true = stepped(6.0)
    data = measured(true, seed=5)
    tracks = {name: tracked(data, METHODS[name]()) for name in ("ekf", "rls")}

    def run(track: Track, modulus: Array) -> Recording:
        told = (modulus, track.E_Pa, track.E_sd_Pa, track.F_sim_N, track.residual_Nm)
        measurements = (*data.v_cmd_m_s.T, *data.x_m.T, data.tau2_Nm, data.strain_prev, data.F_next_N)
        shown = ("E_true_Pa", "E_sim_Pa", "E_sd_Pa", "F_sim_N", "tau2_residual_Nm")
        channels = dict(zip((*NEEDED, *shown), (*measurements, *told), strict=True))
        return Recording({"t_s": data.t_s} | channels)

    online = compare_runs(model(), {name: run(track, true) for name, track in tracks.items()})
    offline = compare_methods(model(), data, {name: METHODS[name]() for name in tracks}, true)
    assert online.bound_time_to_1pct_s == offline.bound_time_to_1pct_s
    for one, other in zip(online.results, offline.results, strict=True):
        assert (one.method, one.time_to_1pct_s, one.covered) == (other.method, other.time_to_1pct_s, other.covered)
        assert one.cpu_us is None
    assert all(row[-1] == "–" for row in rows(online))
    told = estimates(online)
    assert list(told.channels) == ["t_s", "ekf_E_Pa", "ekf_E_sd_Pa", "rls_E_Pa", "rls_E_sd_Pa"]
    assert told["rls_E_sd_Pa"].tolist() == tracks["rls"].E_sd_Pa.tolist()
    with pytest.raises(UnusableInputError, match="rls: E changes otherwise"):
        compare_runs(model(), {"ekf": run(tracks["ekf"], true), "rls": run(tracks["rls"], true * 1.01)})
