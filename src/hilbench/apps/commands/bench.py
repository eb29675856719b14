"""A bench run, checked and stopped, and its processes by themselves. Each imports what it needs when it runs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from hilbench.apps.cli.config_file import load_config
from hilbench.apps.cli.options import (
    BusOption,
    ConfigArgument,
    JsonOption,
    OutOption,
    PacedByOption,
    PaceOption,
    SetOption,
)


def run(
    config: ConfigArgument,
    bus: BusOption = None,
    pace: PaceOption = None,
    out: OutOption = Path("runs"),
    seed: Annotated[int | None, Option(help="seed of every random number of the run")] = None,
    changes: SetOption = None,
    start: Annotated[
        bool,
        Option(help="start simulated hardware and twin, or use those that run on the bus already"),
    ] = True,
    in_process: Annotated[
        bool,
        Option(
            "--in-process",
            help="simulated hardware and twin in this process: the same frames and recording, faster, but on no bus: "
            "no monitor receives them; in real time they wait for SYNC, and no answer comes late",
        ),
    ] = False,
    report: Annotated[bool, Option(help="write report.html; hilbench report writes it later as well")] = True,
    json: Annotated[
        bool,
        Option(
            "--json",
            help="print one JSON object on standard output, nothing else: run folder, files, exit code, result",
        ),
    ] = False,
    force: Annotated[
        bool, Option("--force", help="run although another master is on the bus (not with another hilbench)")
    ] = False,
    require_criteria: Annotated[
        bool, Option("--require-criteria", help="exit code 1 where no criterion judges the run")
    ] = False,
    stream: Annotated[
        list[str] | None,
        Option(
            metavar="TARGET",
            help="samples as they come: FILE.mcap, foxglove, plotjuggler or mqtt (:HOST:PORT); repeatable",
        ),
    ] = None,
) -> None:
    """Run a bench and its experiment; leaves a run folder with recording, trace, result and report.

    Exit code: 0 passed, or completed where nothing was judged, 1 a criterion failed, 2 unusable input, 3 bench fault,
    130 interrupted.

    Example: hilbench run bench_configs/web_section_step.yaml --seed 7

    Example: hilbench run bench_configs/web_section_step.yaml --set load.web.youngs_modulus_Pa=9e9

    Example: hilbench run bench_configs/web_section_step.yaml --in-process --no-report

    Example: hilbench run bench_configs/web_section_step.yaml --stream run.mcap --stream plotjuggler
    """
    if in_process and not start:
        raise typer.BadParameter("--in-process and --no-start exclude each other")
    from hilbench.real_time import for_good

    with for_good():
        from hilbench.bench.lifecycle.participants import Participants
        from hilbench.bench.lifecycle.startup import copies_beside

        loaded = load_config(config, bus=bus, pace=pace, seed=seed, changes=changes or ())
        from hilbench.apps.history.web_line_priors import with_commissioned

        loaded = with_commissioned(loaded, out, lambda text: print(text, file=sys.stderr))
    _make_ready(loaded.config, quiet=json)
    participants = Participants.IN_PROCESS if in_process else Participants.STARTED if start else Participants.PRESENT
    with copies_beside(loaded.config, participants) as beside:
        with for_good():  # while they load what they need
            from hilbench.apps.commands.run import run_command
        code = run_command(
            loaded,
            out,
            participants=participants,
            with_report=report,
            as_json=json,
            beside=beside,
            force=force,
            stream=stream or (),
            require_criteria=require_criteria,
        )
    raise typer.Exit(code)


def _make_ready(config: Any, *, quiet: bool) -> None:
    """Compile what a run needs, where that has not been done, and say how far it is."""
    from hilbench.apps.commands.needed_code import compile_on_all_cores, missing

    if functions := missing(config):
        from rich.console import Console

        from hilbench.apps.cli.progress import ProgressDisplay

        with ProgressDisplay(Console(stderr=True, highlight=False), quiet=quiet) as display:
            compile_on_all_cores(functions, display.announce)


def demo() -> None:
    """Run the published step-change experiment: the example web_section_step, copied to this folder where it is not.

    At t = 10 s Young's modulus of the emulated web steps from 8700 to 10 500 N/mm²; the twin finds the new value.

    Example: hilbench demo
    """
    from hilbench.runs.examples import PUBLISHED, copy

    run(copy(PUBLISHED, Path())[0])


def check(config: ConfigArgument, bus: BusOption = None, changes: SetOption = None, json: JsonOption = False) -> None:
    """Check a config, its EDS files, PDO maps and bus load without starting anything.

    Example: hilbench check bench_configs/web_section_step.yaml
    """
    from hilbench.apps.commands.check import check_command

    check_command(load_config(config, bus=bus, changes=changes or ()), as_json=json)


def simulate_hardware(
    config: ConfigArgument, bus: BusOption = None, pace: PacedByOption = "realtime", changes: SetOption = None
) -> None:
    """Simulate the drives of a bench (of its axes, and the load motors) until interrupted, for any CANopen master.

    Time is the clock's, whatever the SYNC period; the pace of the config is that of the bench, and does not count here.

    Example: hilbench simulate-hardware bench_configs/web_section_step.yaml --bus socketcan:vcan0

    Example: hilbench simulate-hardware bench_configs/web_section_step.yaml --set hardware.sensors.torque_noise_Nm=0.1
    """
    from hilbench.hardware.simulation import simulate
    from hilbench.processes import report_lost_frames

    report_lost_frames(simulate(load_config(config, bus=bus, pace=pace, changes=changes or ()).config))


def twin(
    config: ConfigArgument, bus: BusOption = None, pace: PacedByOption = "realtime", changes: SetOption = None
) -> None:
    """Run the twin of a bench: virtual axes, virtual I/O and synchronizer, until interrupted.

    Example: hilbench twin bench_configs/web_section_step.yaml --bus socketcan:vcan0
    """
    from hilbench.processes import report_lost_frames
    from hilbench.twin.run import run

    report_lost_frames(run(load_config(config, bus=bus, pace=pace, changes=changes or ()).config))


def estop(
    bus: Annotated[
        list[str] | None, Option(help="bus to stop, can be given more than once; without it everything on this machine")
    ] = None,
) -> None:
    """Emergency stop: every device on the bus stops at once, and the bench ends in the safe state (exit code 3).

    Without --bus it stops every bench of this machine that is the user's (root: everybody's), whatever shell, session
    or service has started it, and every CAN interface that is up; it says what was reached and what was not.

    Exit code: 0 sent and no node says OPERATIONAL any more, 2 no bus to stop, 3 a bus on which a bench is known could
    not be told, or a node is still OPERATIONAL.

    Example: hilbench estop --bus socketcan:can0
    """
    from hilbench.apps.commands.estop import estop_command

    raise typer.Exit(estop_command(bus))


def recover(run_folder: Annotated[Path, Argument(metavar="RUN", help="folder of a run that was cut off")]) -> None:
    """Rebuild what a run that was cut off could not write (recording, result, report) from its trace.

    Nothing that is there already is overwritten.

    Example: hilbench recover runs/web_section_step-20260101-120000
    """
    from hilbench.apps.report.html import write_report
    from hilbench.results.recording import read_recording
    from hilbench.results.recover import recover_run
    from hilbench.results.run_folder import RunFolder

    folder = RunFolder.open(run_folder)
    written = recover_run(folder)
    if not folder.report.exists():
        written.append(write_report(folder))
    recording = read_recording(folder.recording)
    print(f"{recording.samples} samples, {recording.time_s[-1]:.3f} s recovered", *written, sep="\n")
