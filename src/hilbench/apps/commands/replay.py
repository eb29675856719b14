"""`hilbench replay`: a trace back onto a bus, or the twin over a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from hilbench.apps.cli.options import BusOption, ForceOption, JsonOption, print_json
from hilbench.errors import UnusableInputError
from hilbench.machine_kinds import DEFAULT

if TYPE_CHECKING:
    from hilbench.results.recording import Recording
    from hilbench.results.run_folder import RunFolder
    from hilbench.runs.config import ExperimentConfig


def replay(
    run: Annotated[Path, Argument(metavar="RUN", help="run folder, or a trace (.log, .asc, .blf, .trc)")],
    bus: BusOption = None,
    twin: Annotated[bool, Option("--twin", help="run the twin over the recording instead")] = False,
    method: Annotated[str | None, Option(help="--twin: another synchronizer than the run's")] = None,
    out: Annotated[Path | None, Option(help="--twin: recording (.mf4, .csv) with the new twin's signals")] = None,
    speed: Annotated[float, Option(help="so many times as fast as it was")] = 1.0,
    commands: Annotated[bool, Option(help="send NMT, SYNC, RPDOs and SDO requests too: nodes obey")] = False,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Send a trace onto a bus in its own time, or let the twin work on a recording as if it were live.

    Onto a bus goes what nodes said; what they were told only with --commands. A bus with a master (a bench that runs,
    or one received) is left alone.

    Example: hilbench replay runs/web_section_step-20260101-120000 --bus socketcan:vcan0

    Example: hilbench replay runs/web_section_step-20260101-120000 --twin --method ekf --out again.mf4
    """
    data = _twin(run, method, out) if twin else _trace(run, bus, speed, commands=commands, force=force)
    if json:
        print_json(data)
    else:
        for name, value in data.items():
            print(f"{name.replace('_', ' ')}: {value:.6g}" if isinstance(value, float) else f"{name}: {value}")


def _trace(run: Path, bus: str | None, speed: float, *, commands: bool, force: bool) -> dict[str, Any]:
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.results.replay import replay as replay_frames
    from hilbench.results.run_folder import RunFolder
    from hilbench.results.trace_files import read_trace

    if not speed > 0:
        raise UnusableInputError("--speed", f"{speed:g}, expected a positive factor")
    path = RunFolder.open(run).trace if run.is_dir() else run
    frames = read_trace(path)
    with BusSession(None, bus) as on:
        on.be_only_master(f"replay of {run}", force=force)
        done = replay_frames(frames, on.link(), speed=speed, commands=commands)
    return {"frames": done.frames, "left_out": done.left_out, "largest_lateness_s": done.latest_s}


def _twin(run: Path, method: str | None, out: Path | None) -> dict[str, Any]:
    import numpy as np

    from hilbench.apps.cli.columns import reported_section
    from hilbench.machine_kinds import description
    from hilbench.results.journal import read_journal
    from hilbench.results.recording import Recording, write_recording
    from hilbench.results.run_folder import RunFolder
    from hilbench.runs.config import load
    from hilbench.runs.events import journal_events
    from hilbench.runs.metrics import evaluate_metrics

    folder: RunFolder = RunFolder.open(run)
    config, _ = load(folder.config)
    recording = reported_section(folder.recording)
    kind = description(config.machine.kind).recorded_as or config.machine.kind
    if kind not in _OF_KIND:
        raise UnusableInputError(folder.config, f"machine of kind {kind}, expected one of {', '.join(_OF_KIND)}")
    found = _OF_KIND[kind](config, folder.config, recording, folder.recording, method)
    again = Recording({**recording.channels, **found.signals}, recording.start_time, recording.comment, recording.units)
    if out is not None:
        write_recording(again, out)

    def rms_difference(name: str) -> float:
        part = slice(len(recording) // 2, None)
        return float(np.sqrt(np.mean((again[name][part] - recording[name][part]) ** 2)))

    figures: dict[str, Any] = {"method": found.method, "cycles": len(again)}
    for name in found.compared:
        if name in recording:
            figures[f"rms_difference_{name}"] = rms_difference(name)
    changes = read_journal(folder.journal) if folder.journal.exists() else []
    metrics = evaluate_metrics(again.channels, journal=journal_events(changes, config.cycle_time_s))
    figures |= {name: value for name, value in metrics.items() if name.startswith(found.metrics)}
    return figures


@dataclass(frozen=True)
class _Found:
    """Estimates of a recording by the twin of a kind of machine."""

    method: str
    signals: dict[str, Any]  #: channels (n,) by name
    compared: tuple[str, ...]  #: those that are compared with what was recorded
    metrics: tuple[str, ...]  #: how the names of its metrics begin


def _of_a_web(
    config: ExperimentConfig, config_path: Path, recording: Recording, place: Path, method: str | None
) -> _Found:
    from hilbench.apps.cli.model_option import web_line_of
    from hilbench.estimation.web_line.offline import run_offline
    from hilbench.results.web_line_synchronization import measurements_of, methods_of, require_one_span

    model = web_line_of(config.machine, config_path)
    require_one_span(model, config_path)
    twin = config.twin
    if method is not None:
        chosen = methods_of(method)
        if len(chosen) != 1:
            raise UnusableInputError("--method", f"'{method}', expected one method")
        twin = twin.model_copy(update={"estimate": list(chosen.values())})
    track = run_offline(model, twin, measurements_of(recording, place))
    signals = {
        "F_sim_N": track.F_sim_N,
        "E_sim_Pa": track.E_Pa,
        "E_sd_Pa": track.E_sd_Pa,
        "tau2_residual_Nm": track.residual_Nm,
    }
    return _Found(twin.synchronizer.method, signals, ("F_sim_N", "E_sim_Pa"), ("E_",))


def _of_a_shaft(
    config: ExperimentConfig, config_path: Path, recording: Recording, place: Path, method: str | None
) -> _Found:
    import numpy as np

    from hilbench.estimation.servo_axis.offline import ShaftRecording, track

    settings = config.twin.inertia
    if method not in (None, settings.method):
        raise UnusableInputError("--method", f"'{method}', expected {settings.method}: a servo axis has no other")
    needed = ("v1_cmd_rad_s", "x1_rad", "tau1_Nm")
    recording.require(needed, place)
    command, x, tau = (np.asarray(recording[name], np.float64) for name in needed)
    found = track(config.servo_axis, settings, ShaftRecording(config.cycle_time_s, command, x, tau))
    signals = {"J_sim_kg_m2": found.inertia_kg_m2, "J_sd_kg_m2": found.deviation_kg_m2}
    friction = found.also.get("coulomb_friction_Nm")
    if friction is not None:
        signals["coulomb_sim_Nm"] = friction[0]
    return _Found(settings.method, signals, tuple(signals), ("J_", "coulomb_"))


_OF_KIND = {DEFAULT: _of_a_web, "servo_axis": _of_a_shaft}
