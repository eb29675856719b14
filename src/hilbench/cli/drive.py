"""`hilbench drive NODE enable|disable|jog|reset|status`: one drive by hand."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hilbench.canopen.identifiers import COB_ID, HEARTBEAT, NMT, NmtState
from hilbench.cli.options import BusOption, ConfigOption, EdsOption, ForceOption, JsonOption, NodeArgument
from hilbench.errors import UnusableInputError

if TYPE_CHECKING:
    from hilbench.cia402.manual import DriveStatus, ManualDrive

_HEARTBEAT_S = 0.1
_HEARTBEAT_TIME_OUT_MS = 500
_STEP_S = 0.02
_FORWARD, _BACKWARD, _QUIT = "f", "b", ("q", "\x1b", "\x03", "")


class Action(StrEnum):
    """What is done."""

    ENABLE = "enable"
    DISABLE = "disable"
    JOG = "jog"
    RESET = "reset"
    STATUS = "status"


def drive(
    node: NodeArgument,
    action: Annotated[Action, typer.Argument(metavar="ACTION", help="enable, disable, jog, reset or status")],
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    speed: Annotated[float, typer.Option("--speed", metavar="RAD/S", min=0.0, help="jog: velocity of the motor")] = 5.0,
    timeout: Annotated[float, typer.Option("--timeout", metavar="S", min=0.1, help="longest way to a state")] = 5.0,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Enable, disable, reset or jog one drive by SDO (profile velocity mode), or show its decoded status.

    enable leaves the drive at velocity 0 with its power stage on when the command has ended; disable takes it away.

    jog: hold f (forward) or b (backward): the key is the dead-man switch, let go and the drive stops; any other key
    stops it too, q ends. The drive watches this program's heartbeat (1016h) and stops without it. Nothing but status
    is done while another master is at work on the bus.

    Example: hilbench drive 1 status --bus socketcan:can0

    Example: hilbench drive axis1 jog --speed 10 --config bench_configs/web_section_step.yaml
    """
    with _drive(node, config, bus, eds, timeout, action, force=force) as (manual, heartbeat):
        if action is Action.ENABLE:
            manual.enable()
        elif action is Action.DISABLE:
            manual.disable()
        elif action is Action.RESET:
            manual.reset()
        elif action is Action.JOG:
            _jog(manual, heartbeat, speed)
        _print(manual.status(), as_json=json)


@contextmanager
def _drive(
    node: str, config: Path | None, bus: str | None, eds: Path, time_out_s: float, action: Action, *, force: bool
) -> Iterator[tuple[ManualDrive, Callable[[], None]]]:
    from contextlib import ExitStack, suppress

    from hilbench.can.frame import Frame
    from hilbench.can.open import open_link
    from hilbench.cia402.configuration import read_units
    from hilbench.cia402.manual import ManualDrive
    from hilbench.cli.attach import MASTER_ID, config_and_bus, known_to_master, node_on_bus, only_master

    bench, address = config_and_bus(config, bus)
    with ExitStack() as resources:
        if action is not Action.STATUS:
            what = f"drive by hand, node {node}"
            resources.enter_context(only_master(address, bench, what, force=force))
        node_id, name, od = node_on_bus(node, bench, address, eds)
        link = open_link(address)
        resources.callback(link.close)
        link.set_filters([(NMT, COB_ID)])  # nothing is received here: NMT commands are for the devices
        master = known_to_master(address, node_id, od, name)
        resources.callback(master.close)
        units = None
        with suppress(UnusableInputError):  # state and statusword are there without units
            units = read_units(master, node_id, od, {} if bench is None else bench.units_of(node_id), name)
        yield (
            ManualDrive(master, node_id, name, units, time_out_s),
            lambda: link.send([Frame(HEARTBEAT + MASTER_ID, NmtState.OPERATIONAL.heartbeat)]),
        )


def _jog(manual: ManualDrive, heartbeat: Callable[[], None], speed_rad_s: float) -> None:
    """Hold-to-run until q; the drive is disabled when it ends, however it ends."""
    from hilbench.cli.attach import MASTER_ID

    # The drive watches from the first heartbeat on: from before the first key until the power stage is off.
    with _keys() as key_pressed, manual.watching(MASTER_ID, _HEARTBEAT_TIME_OUT_MS):
        try:
            manual.enable()
            print(f"hold {_FORWARD} (forward) or {_BACKWARD} (backward), q ends", file=sys.stderr, flush=True)
            _follow_keys(manual, key_pressed, heartbeat, speed_rad_s)
            manual.stop()
        finally:
            manual.disable()


def _follow_keys(
    manual: ManualDrive, key_pressed: Callable[[float], str | None], heartbeat: Callable[[], None], speed_rad_s: float
) -> None:
    from hilbench.cia402.manual import DeadManKey

    key, commanded, next_heartbeat_s = DeadManKey(), 0, 0.0
    while True:
        now_s = time.monotonic()
        if now_s >= next_heartbeat_s:
            next_heartbeat_s = now_s + _HEARTBEAT_S
            heartbeat()
        pressed = key_pressed(_STEP_S)
        if pressed in _QUIT:
            return
        if pressed is not None:
            key.pressed({_FORWARD: 1, _BACKWARD: -1}.get(pressed, 0), time.monotonic())
        wanted = key.held(time.monotonic())
        if wanted != commanded:
            commanded = wanted
            manual.move(wanted * speed_rad_s)


@contextmanager
def _keys() -> Iterator[Callable[[float], str | None]]:
    """Single keys of the terminal: a function that waits so long for one; "" when the terminal is gone."""
    import os
    import select
    import sys
    import termios
    import tty

    if not sys.stdin.isatty():
        raise UnusableInputError("standard input", "no terminal, expected one: its keys are the dead-man switch")
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)

    def key_pressed(wait_s: float) -> str | None:
        ready, _, _ = select.select([terminal], [], [], wait_s)
        return os.read(terminal, 1).decode("latin-1") if ready else None

    tty.setcbreak(terminal)
    try:
        yield key_pressed
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _print(status: DriveStatus, *, as_json: bool) -> None:
    from dataclasses import asdict
    from json import dumps

    if as_json:
        print(dumps(asdict(status), indent=2))
        return
    print(f"{status.state}  (statusword {status.statusword:04X}h: {', '.join(status.flags) or 'no flags'})")
    print(
        f"mode {_or_dash(status.mode)}, error code {'-' if status.error_code is None else f'{status.error_code:04X}h'}"
    )
    parts = ((status.position_rad, "rad"), (status.velocity_rad_s, "rad/s"), (status.torque_Nm, "N·m"))
    print(", ".join(f"{value:.5g} {unit}" for value, unit in parts if value is not None) or "units are not known")


def _or_dash(value: int | None) -> str:
    return "-" if value is None else str(value)
