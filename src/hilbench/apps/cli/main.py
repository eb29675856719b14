"""The `hilbench` command. Each command imports what it needs when it runs, so that `--help` is fast."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable
from copy import copy
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.main import get_command_name
from typer.models import CommandInfo

from hilbench.apps.cli import (
    boot,
    commission,
    compare,
    compile,
    config,
    conformance,
    convert,
    drift,
    drive,
    examples,
    fmu,
    gateway,
    history,
    lss,
    monitor,
    replay,
    runs,
    scan,
    sdo,
    sweep,
    what_if,
)
from hilbench.apps.cli.commands import Commands
from hilbench.apps.cli.options import (
    BusOption,
    ConfigArgument,
    JsonOption,
    PacedByOption,
    PaceOption,
    RunArgument,
    SetOption,
)
from hilbench.errors import UnusableInputError
from hilbench.exit_status import ended
from hilbench.real_time import for_good

app = typer.Typer(
    name="hilbench",
    cls=Commands,
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},  # the commands inherit it
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"hilbench {version('hilbench')}")
        raise typer.Exit


@app.callback()
def hilbench(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="print the version and exit")
    ] = False,
) -> None:
    """Hardware-in-the-loop test bench over CAN/CANopen with a synchronized twin of the machine."""


def _load(config: Path, **overrides: Any) -> Any:
    from hilbench.runs.config import load_with_overrides

    try:
        return load_with_overrides(config, **overrides)
    except UnusableInputError as error:
        from hilbench.runs.examples import names

        if not config.exists() and config.stem in names():
            error.add_note(f"`hilbench examples {config.stem}` copies the example of this name to bench_configs")
        raise


def _make_ready(config: Any, *, quiet: bool) -> None:
    """Compile what a run needs, where that has not been done, and say how far it is."""
    from hilbench.apps.cli.needed_code import compile_on_all_cores, missing

    if functions := missing(config):
        from rich.console import Console

        from hilbench.apps.cli.progress import ProgressDisplay

        with ProgressDisplay(Console(stderr=True, highlight=False), quiet=quiet) as display:
            compile_on_all_cores(functions, display.announce)


@app.command()
def run(
    config: ConfigArgument,
    bus: BusOption = None,
    pace: PaceOption = None,
    out: Annotated[Path, typer.Option("--out", help="folder in which the run folder is made")] = Path("runs"),
    seed: Annotated[int | None, typer.Option("--seed", help="seed of every random number of the run")] = None,
    changes: SetOption = None,
    start: Annotated[
        bool,
        typer.Option(
            "--start/--no-start", help="start simulated hardware and twin, or use those that run on the bus already"
        ),
    ] = True,
    in_process: Annotated[
        bool,
        typer.Option(
            "--in-process",
            help="simulated hardware and twin in this process: the same frames and recording, faster, but on no bus: "
            "no monitor receives them; in real time they wait for SYNC, and no answer comes late",
        ),
    ] = False,
    report: Annotated[
        bool, typer.Option("--report/--no-report", help="write report.html; hilbench report writes it later as well")
    ] = True,
    json: Annotated[
        bool,
        typer.Option(
            "--json",
            help="print one JSON object on standard output, nothing else: run folder, files, exit code, result",
        ),
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="run although another master is on the bus (not with another hilbench)")
    ] = False,
    require_criteria: Annotated[
        bool, typer.Option("--require-criteria", help="exit code 1 where no criterion judges the run")
    ] = False,
    stream: Annotated[
        list[str] | None,
        typer.Option(
            "--stream",
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
    with for_good():
        from hilbench.bench.lifecycle.participants import Participants
        from hilbench.bench.lifecycle.startup import copies_beside

        loaded = _load(config, bus=bus, pace=pace, seed=seed, changes=changes or ())
        from hilbench.apps.history.web_line_priors import with_commissioned

        loaded = with_commissioned(loaded, out, lambda text: print(text, file=sys.stderr))
    _make_ready(loaded.config, quiet=json)
    participants = Participants.IN_PROCESS if in_process else Participants.STARTED if start else Participants.PRESENT
    with copies_beside(loaded.config, participants) as beside:
        with for_good():  # while they load what they need
            from hilbench.apps.cli.run import run_command
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


@app.command()
def demo() -> None:
    """Run the published step-change experiment: the example web_section_step, copied to this folder where it is not.

    At t = 10 s Young's modulus of the emulated web steps from 8700 to 10 500 N/mm²; the twin finds the new value.

    Example: hilbench demo
    """
    from hilbench.runs.examples import PUBLISHED, copy

    run(copy(PUBLISHED, Path())[0])


@app.command()
def check(config: ConfigArgument, bus: BusOption = None, changes: SetOption = None, json: JsonOption = False) -> None:
    """Check a config, its EDS files, PDO maps and bus load without starting anything.

    Example: hilbench check bench_configs/web_section_step.yaml
    """
    from hilbench.apps.cli.check import check_command

    check_command(_load(config, bus=bus, changes=changes or ()), as_json=json)


@app.command()
def doctor(
    config: Annotated[Path | None, typer.Argument(metavar="[CONFIG]", help="bench config (YAML)")] = None,
    bus: BusOption = None,
    pace: PaceOption = None,
    changes: SetOption = None,
    start: Annotated[
        bool,
        typer.Option("--start/--no-start", help="start simulated hardware and twin when they don't run, as run does"),
    ] = True,
    json: Annotated[
        bool, typer.Option("--json", help="print one JSON object on standard output, nothing else")
    ] = False,
) -> None:
    """Examine machine, CAN interface and nodes; says what is wrong and what to type. Writes nothing to any device.

    Exit code: 0 no error found (warnings may be), 1 errors found, 2 unusable input.

    Example: hilbench doctor bench_configs/web_section_step.yaml --bus socketcan:can0
    """
    from hilbench.apps.cli.doctor import doctor_command
    from hilbench.can.open import BusAddress

    if config is None and changes:
        raise UnusableInputError("--set", f"'{changes[0]}' without a config, expected CONFIG to change")
    loaded = None if config is None else _load(config, bus=bus, pace=pace, changes=changes or ())
    address = None
    if loaded is not None:
        address = loaded.config.bus_address
    elif bus is not None:
        address = BusAddress.parse(bus).as_it_runs()
    raise typer.Exit(doctor_command(loaded, address, start=start, as_json=json))


@app.command("simulate-drive")
def simulate_drive(
    eds: Annotated[Path, typer.Argument(metavar="EDS", help="EDS or DCF file of a CiA-402 drive")],
    node: Annotated[
        int | None,
        typer.Option(
            "--node", min=1, max=127, help="node id, of the first of several", show_default="1; with --lss none"
        ),
    ] = None,
    bus: Annotated[
        str, typer.Option("--bus", help="embedded:NAME, socketcan:vcan0, or another python-can interface:channel")
    ] = "embedded",
    count: Annotated[int, typer.Option("--count", min=1, max=127, help="so many drives, ids in a row")] = 1,
    plant: Annotated[
        Path | None, typer.Option("--plant", help="model file or config of a servo_axis: what the motor turns")
    ] = None,
    behaviour: Annotated[
        Path | None, typer.Option("--behaviour", help="YAML file: switches, units, and what the drive does wrong")
    ] = None,
    lss: Annotated[
        bool, typer.Option("--lss", help="node ids can be given by LSS; without --node the drives wait for theirs")
    ] = False,
    serial: Annotated[
        int | None,
        typer.Option(
            "--serial",
            min=0,
            max=0xFFFF_FFFF,
            help="serial number (1018h sub 4), of the first of several",
            show_default="that of the file; with --lss 1",
        ),
    ] = None,
) -> None:
    """A drive on a bus that is not there: as its EDS file describes it, with CiA 402 behind its objects.

    Example: hilbench simulate-drive eds/hilbench_servo.eds --node 5 --bus socketcan:vcan0
    """
    from hilbench.apps.cli.simulate_drive import simulate_drive_command

    simulate_drive_command(eds, node, bus, count=count, plant=plant, behaviour_file=behaviour, lss=lss, serial=serial)


@app.command("simulate-hardware")
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

    report_lost_frames(simulate(_load(config, bus=bus, pace=pace, changes=changes or ()).config))


@app.command()
def twin(
    config: ConfigArgument, bus: BusOption = None, pace: PacedByOption = "realtime", changes: SetOption = None
) -> None:
    """Run the twin of a bench: virtual axes, virtual I/O and synchronizer, until interrupted.

    Example: hilbench twin bench_configs/web_section_step.yaml --bus socketcan:vcan0
    """
    from hilbench.processes import report_lost_frames
    from hilbench.twin.run import run

    report_lost_frames(run(_load(config, bus=bus, pace=pace, changes=changes or ()).config))


@app.command()
def estop(
    bus: Annotated[
        list[str] | None,
        typer.Option("--bus", help="bus to stop, can be given more than once; without it everything on this machine"),
    ] = None,
) -> None:
    """Emergency stop: every device on the bus stops at once, and the bench ends in the safe state (exit code 3).

    Without --bus it stops every bench of this machine that is the user's (root: everybody's), whatever shell, session
    or service has started it, and every CAN interface that is up; it says what was reached and what was not.

    Exit code: 0 sent and no node says OPERATIONAL any more, 2 no bus to stop, 3 a bus on which a bench is known could
    not be told, or a node is still OPERATIONAL.

    Example: hilbench estop --bus socketcan:can0
    """
    from hilbench.apps.cli.estop import estop_command

    raise typer.Exit(estop_command(bus))


@app.command()
def recover(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="folder of a run that was cut off")],
) -> None:
    """Rebuild what a run that was cut off could not write (recording, result, report) from its trace.

    Nothing that is there already is overwritten.

    Example: hilbench recover runs/web_section_step-20260101-120000
    """
    from hilbench.apps.cli.recover import recover_command

    recover_command(run_folder)


@app.command()
def report(
    run_folder: RunArgument,
    pictures: Annotated[
        Path | None, typer.Option("--pictures", metavar="DIR", help="write its pictures alone, each as a file in DIR")
    ] = None,
    form: Annotated[
        str | None, typer.Option("--format", metavar="FORMAT", help="of the pictures: svg or png", show_default="svg")
    ] = None,
) -> None:
    """Write the report of a run folder anew, or its pictures one by one.

    Example: hilbench report runs/web_section_step-20260101-120000

    Example: hilbench report runs/web_section_step-20260101-120000 --pictures pictures --format png
    """
    from hilbench.apps.report.html import write_pictures, write_report
    from hilbench.results.run_folder import RunFolder

    if form not in (None, "svg", "png"):
        raise UnusableInputError("--format", f"'{form}', expected svg or png")
    if form is not None and pictures is None:
        raise UnusableInputError("--format", "without --pictures, expected a folder for the pictures")
    folder = RunFolder.open(run_folder)
    if pictures is None:
        print(write_report(folder))
    else:
        print(*write_pictures(folder, pictures, "png" if form == "png" else "svg"), sep="\n")


@app.command()
def sync(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", help="recording (.mf4, .csv, .csv.gz), or a bench config (.yaml) to run each method on"
        ),
    ],
    model: Annotated[
        Path | None,
        typer.Option("--model", help="model file, or a bench config with the model in it (YAML); a bench has its own"),
    ] = None,
    method: Annotated[str, typer.Option("--method", help="methods, comma-separated, or all")] = "all",
    out: Annotated[
        Path | None,
        typer.Option("--out", help="folder for the page and the estimates over time (CSV); a bench's runs, too (sync)"),
    ] = None,
    unmodelled_torque: Annotated[
        float | None,
        typer.Option(
            "--unmodelled-torque",
            min=0.0,
            metavar="N·m",
            help="all that the model may lack: a lasting error of the torque (standard deviation)",
            show_default="friction, scale and the rest are looked for",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="runs of a bench at a time")] = 1,
    json: Annotated[bool, typer.Option("--json", help="print the figures as JSON, nothing else")] = False,
) -> None:
    """Compare synchronizers: time to 1 %, overshoot, noise, bias, coverage of intervals, cost, and the bound.

    On a recording every method sees the same samples. With a bench config each method has a run of its own, with real
    processes and frames and the tension loop closed on its twin.

    With --out: sync.html, and estimates.csv with t_s, METHOD_E_Pa and METHOD_E_sd_Pa (standard deviation) of each
    method in every row.

    Example: hilbench sync runs/web_section_step-20260101-120000/recording.mf4 --model model.yaml --out comparison

    Example: hilbench sync bench_configs/synchronizers.yaml --out comparison
    """
    from hilbench.apps.cli.sync import sync_command, sync_runs_command

    if source.suffix in (".yaml", ".yml"):
        sync_runs_command(source, method, out, jobs, as_json=json)
    elif model is None:
        raise UnusableInputError("--model", "missing, expected the model of the recorded machine")
    else:
        sync_command(source, model, method, out, unmodelled_torque, as_json=json)


@app.command()
def diagnose(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="recording (.mf4, .csv, .csv.gz) or run folder, or a bench config (.yaml) to run and diagnose",
        ),
    ],
    model: Annotated[
        Path | None,
        typer.Option("--model", help="model file, or a bench config with the model in it (YAML); a bench has its own"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="folder for the page, the extended model (model_extended.yaml) and bench (config_extended.yaml)",
        ),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(
            "--against",
            metavar="RECORDING",
            help="recording of the same machine before: name what changed since; a lone axis needs no --model for that",
        ),
    ] = None,
    next_experiment: Annotated[
        Path | None,
        typer.Option(
            "--next-experiment",
            metavar="FILE",
            help="write steps of at most 30 s that would separate tied effects, or excite what was not (YAML)",
        ),
    ] = None,
    until_clear: Annotated[
        bool,
        typer.Option("--until-clear", help="of a bench config: run on with such steps until nothing is tied"),
    ] = False,
    bus: BusOption = None,
    changes: SetOption = None,
    json: Annotated[bool, typer.Option("--json", help="print the diagnosis as JSON, nothing else")] = False,
) -> None:
    """Find where simulation and measurement disagree, name the missing effect, and add it to the model.

    What is found in a run of a bench goes into its folder (diagnosis.json) and the history of its stand. --bus and
    --set are those of hilbench run, for a bench config that is run.

    Exit code: 0 diagnosed, whatever the verdict; 2 unusable input; 3 a run of the bench faulted, 130 interrupted.

    Example: hilbench diagnose runs/web_section_step-20260101-120000/recording.mf4 --model model.yaml --out diagnosis

    Example: hilbench diagnose bench_configs/hidden_friction.yaml --out found

    Example: hilbench diagnose bench_configs/hidden_friction.yaml --until-clear --out found

    Example: hilbench diagnose after.csv --against before.csv --out changed
    """
    from hilbench.apps.cli.diagnose import diagnose_command

    diagnose_command(
        source,
        model,
        out,
        as_json=json,
        against=against,
        next_experiment=next_experiment,
        until_clear=until_clear,
        bus=bus,
        changes=changes or (),
    )


app.command()(examples.examples)
app.command()(scan.scan)
app.command()(boot.boot)
app.command()(gateway.gateway)
app.add_typer(sdo.app, name="sdo")
app.add_typer(lss.app, name="lss")
app.add_typer(config.app, name="config")
app.add_typer(runs.app, name="runs")
app.add_typer(fmu.app, name="fmu")
app.command()(drive.drive)
app.command()(conformance.conformance)
app.command()(replay.replay)
app.command()(monitor.monitor)
app.command()(compare.compare)
app.command()(commission.commission)
app.command()(history.history)
app.command("what-if")(what_if.what_if)
app.command()(drift.drift)
app.command()(sweep.sweep)
app.command()(convert.convert)
app.command("compile")(compile.compile_entry_points)
app.command()(convert.dbc)


@cache
def _command(name: str) -> Callable[[], object]:
    """The command of this name, by itself; all of them where none has it. They are made from their signatures, once in
    a process: for all of them that takes longer than many a command."""
    named = [each for each in app.registered_commands if _name_of(each) == name]
    if not named:
        return _with_flowing_help(typer.main.get_command(app))
    alone = copy(app)
    alone.registered_commands, alone.registered_groups = named, []
    return _with_flowing_help(typer.main.get_command(alone))


def _with_flowing_help(command: Any) -> Callable[[], object]:
    """A command, and those below it, whose help goes to the width of the terminal, not to that of the source."""
    if command.help:
        command.help = "\n\n".join(" ".join(part.split()) for part in command.help.split("\n\n"))
    for each in getattr(command, "commands", {}).values():
        _with_flowing_help(each)
    flowing: Callable[[], object] = command
    return flowing


def _name_of(command: CommandInfo) -> str:
    assert command.callback is not None
    return command.name or get_command_name(command.callback.__name__)


#: What a command imports stays: to look through it for garbage as often as Python does takes a sixth of its start.
_NEW_OBJECTS_BEFORE_COLLECTION = 10_000
#: Matrices are many and small: threads of one product wait for each other for longer than they work. To look for
#: plugins of pydantic in all that is installed takes 28 ms; a command needs none.
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "PYDANTIC_DISABLE_PLUGINS": "__all__"}


def main() -> None:
    """Entry point: errors meant for a person become one line on standard error and the exit code of their kind."""
    gc.set_threshold(_NEW_OBJECTS_BEFORE_COLLECTION)
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    sys.exit(ended(lambda: _command(next(iter(sys.argv[1:]), ""))()))
