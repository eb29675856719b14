"""`hilbench monitor`: a running bench on the bus, watched, and left alone until a key asks for something."""

from __future__ import annotations

import sys
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from hilbench.apps.cli.config_file import load_config
from hilbench.apps.cli.options import BusOption, JsonOption, print_json

if TYPE_CHECKING:
    from hilbench.apps.monitor.picture import BusPicture
    from hilbench.can.link import Link


_READ_S = 0.05


def monitor(
    config: Annotated[
        Path,
        Argument(
            metavar="CONFIG",
            help="config (YAML) of the bench; with --browser a folder of runs instead shows these alone",
        ),
    ],
    bus: BusOption = None,
    pace: Annotated[str | None, Option(help="that of the run, where it is not the config's")] = None,
    duration: Annotated[float, Option("--for", metavar="S", min=0.1, help="--json: how long to listen")] = 1.0,
    json: JsonOption = False,
    browser: Annotated[bool, Option("--browser", help="serve a page with plots, for any number of viewers")] = False,
    host: Annotated[
        str | None,
        Option(help="--browser: address to listen at; else only this machine reaches it", show_default="127.0.0.1"),
    ] = None,
    port: Annotated[
        int | None, Option(min=0, max=65535, help="--browser: port; 0: any that is free", show_default="8321")
    ] = None,
    runs: Annotated[Path | None, Option(help="folder in which the runs are", show_default="runs")] = None,
) -> None:
    """Watch a running bench as a listener on its bus: the twin's values, drive states, bus load, jitter, faults.

    It may be started before the bench and stay when it has ended; while no bench runs it says STALE, ENDED or E-STOP
    instead of values. It sends nothing but what a key asks for and a second one confirms: e emergency stop, and a key
    for each quantity of the machine that can be changed (of a web line v line speed, t tension set-point, m E of the
    emulated web; of a servo axis v speed, m inertia, f friction). Where the bench has it, p makes, allows or refuses a
    probe, and c a proposed change of the twin's model. w shows what would come if the speed, the set-point or E went to
    another value. What somebody does is in the journal of the run, with who it was.

    With --json it listens for a while and prints what it received as one object.

    With --browser it prints the address of a page instead, which shows the same with plots of the last minutes, to any
    number of viewers of whom one controls, until Ctrl+C ends it; the bench does not notice.

    Example: hilbench monitor bench_configs/web_section_step.yaml --bus socketcan:can0

    Example: hilbench monitor bench_configs/web_section_step.yaml --browser
    """
    from hilbench.apps.monitor.picture import BusPicture
    from hilbench.can.open import open_link, open_python_can
    from hilbench.errors import UnusableInputError

    if browser:
        from hilbench.apps.pages.server import LOOPBACK, PORT, serve

        bench = None if config.is_dir() else load_config(config, bus=bus, pace=pace).config
        base = config if bench is None else runs or Path("runs")
        serve(bench, base, host or LOOPBACK, PORT if port is None else port, lambda line: print(line, flush=True))
        return
    for option, value in (("--host", host), ("--port", port)):
        if value is not None:
            raise UnusableInputError(option, f"'{value}' without --browser, expected both or none")
    if not json and not sys.stdout.isatty():
        raise UnusableInputError("standard output", "no terminal, expected one for the dashboard, or --json")
    loaded = load_config(config, bus=bus, pace=pace).config
    picture, address = BusPicture(loaded), loaded.bus_address.as_it_runs()
    with ExitStack() as resources:
        link = resources.enter_context(closing(open_link(address)))
        if json:
            _print(picture, link, duration)
            return
        from hilbench.apps.monitor.changes import PATIENCE_S, ChangeRequests, OperatorJournal
        from hilbench.apps.monitor.dashboard import Dashboard
        from hilbench.canopen.sdo_client import SDO_ANSWERS, SdoClient

        operator_journal = OperatorJournal(runs or Path("runs"), link.channel, loaded.cycle_ns)
        changes = ChangeRequests(loaded, lambda: SdoClient(open_python_can(address, SDO_ANSWERS), PATIENCE_S))
        resources.callback(changes.close)
        Dashboard(picture, link, changes, operator_journal).run()


def _print(picture: BusPicture, link: Link, duration_s: float) -> None:
    import time

    until_s = time.monotonic() + duration_s
    while (left_s := until_s - time.monotonic()) > 0:
        picture.take(link.receive(min(left_s, _READ_S)))
    print_json(picture.as_data())
