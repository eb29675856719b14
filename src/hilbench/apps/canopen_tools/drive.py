"""`hilbench drive NODE enable|disable|move|home|jog|velocity|torque|reset|status`: one drive by hand."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from functools import partial
from math import inf, nan, pi
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from hilbench.apps.cli.options import (
    BusOption,
    ConfigOption,
    EdsOption,
    ForceOption,
    JsonOption,
    NodeArgument,
    key_and_number,
    print_json,
)
from hilbench.errors import UnusableInputError

if TYPE_CHECKING:
    from canopen import ObjectDictionary
    from hilbench.canopen.master import Master
    from hilbench.cia402.manual import DriveStatus, ManualDrive
    from hilbench.cia402.set_up import Limits, SetUpDrive
    from hilbench.cia402.units import DriveUnits
    from hilbench.runs.config import ExperimentConfig

_HEARTBEAT_S = 0.1
_HEARTBEAT_TIME_OUT_MS = 500
_STEP_S = 0.02
_FORWARD, _BACKWARD, _QUIT = "f", "b", ("q", "\x1b", "\x03", "")
_QUANTITY = re.compile(r"^\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(\D*?)\s*$")
_TURN_RAD = 2.0 * pi


class Action(StrEnum):
    """Action of the drive."""

    ENABLE = "enable"
    DISABLE = "disable"
    MOVE = "move"
    HOME = "home"
    JOG = "jog"
    VELOCITY = "velocity"
    TORQUE = "torque"
    RESET = "reset"
    STATUS = "status"


#: In N·m, rad and rad/s, motor side; "units" are the drive's own.
_UNITS = {
    Action.MOVE: {"rad": 1.0, "deg": pi / 180.0, "°": pi / 180.0, "turns": _TURN_RAD, "turn": _TURN_RAD},
    Action.VELOCITY: {"rad/s": 1.0, "rpm": _TURN_RAD / 60.0},
    Action.TORQUE: {"N·m": 1.0, "Nm": 1.0},
}
_EXAMPLES = {Action.MOVE: "1.5 turns", Action.VELOCITY: "10 rad/s", Action.TORQUE: "0.2 N·m"}


def drive(
    node: NodeArgument,
    action: Annotated[Action, Argument(metavar="ACTION", help=", ".join(Action))],
    value: Annotated[
        str | None,
        Argument(
            metavar="[VALUE]",
            help="move: rad, deg, turns; velocity: rad/s, rpm; torque: N·m; all: units (the drive's); home: its method",
        ),
    ] = None,
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    speed: Annotated[
        float, Option(metavar="RAD/S", min=0.0, help="jog, move: velocity of the motor; torque: its limit")
    ] = 5.0,
    relative: Annotated[bool, Option("--relative", help="move: from where it is")] = False,
    units: Annotated[
        list[str] | None,
        Option(
            metavar="KEY=VALUE",
            help="position_rad, velocity_rad_s or rated_torque_Nm of a drive without objects for it; repeatable",
        ),
    ] = None,
    duration: Annotated[
        float | None,
        Option("--for", metavar="S", min=0.0, help="velocity, torque: so long", show_default="until Ctrl-C"),
    ] = None,
    timeout: Annotated[float, Option(metavar="S", min=0.1, help="longest time to a state")] = 5.0,
    axis: Annotated[
        int | None, Option(metavar="N", min=1, max=8, help="which axis of a node with several", show_default="1")
    ] = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Set up one drive by SDO: move, home, jog, hold a velocity or torque, enable, disable, reset, or show its status.

    move, home, jog, velocity and torque take a profile mode of the drive, stay within its limits (607Dh, 607Fh, 6080h,
    6072h) and those of the config, and leave it without power. Ctrl-C, or an end by any signal, is a quick stop; the
    drive watches this program's heartbeat (1016h) and stops without it. enable leaves it at velocity 0 with its power
    stage on. status says which of these it can't do, and which object is missing for it.

    jog: hold f (forward) or b (backward): the key is the dead-man switch, let go and the drive stops; any other key
    stops it too, q ends. Nothing but status is done while another master is at work on the bus.

    Example: hilbench drive 1 status --bus socketcan:can0

    Example: hilbench drive 1 move "90 deg" --relative --speed 3 --bus socketcan:can0

    Example: hilbench drive 1 status --units position_rad=0.00157 --units velocity_rad_s=0.105 --bus socketcan:can0

    Example: hilbench drive 1 home 35 --bus socketcan:can0

    Example: hilbench drive 1 status --axis 2 --bus socketcan:can0

    Example: hilbench drive axis1 velocity "60 rpm" --for 0.5 --config bench_configs/web_section_step.yaml

    Example: hilbench drive axis1 jog --speed 10 --config bench_configs/web_section_step.yaml

    A negative value follows "--": hilbench drive 1 move --relative -- "-1 turn"
    """
    if value is not None and action not in (*_UNITS, Action.HOME):
        raise UnusableInputError("VALUE", f"'{value}' with {action}, expected none")
    from hilbench.apps.canopen_tools.attach import MASTER_ID, BusSession
    from hilbench.can.frame import Frame
    from hilbench.canopen.identifiers import COB_ID, HEARTBEAT, NMT, NmtState
    from hilbench.cia402.axis import axes
    from hilbench.cia402.manual import ManualDrive
    from hilbench.cia402.set_up import SetUpDrive
    from hilbench.processes import end_requests

    given = _given_units(units or [])
    with BusSession(config, bus) as on:
        bench = on.bench
        node, of_node = on.drive(node, axis)
        if action is not Action.STATUS:
            on.be_only_master(f"drive by hand, node {node}", force=force)
        master, node_id, name, od = on.device(node, eds)
        there = axes(od.__contains__)
        if of_node > 1 and of_node not in there:
            known = ", ".join(map(str, there)) or "none"
            raise UnusableInputError(
                "--axis", f"{of_node}, expected one that the EDS file of node {node_id} has: {known}"
            )
        link = on.link()
        link.set_filters([(NMT, COB_ID)])  # nothing is received here: NMT commands are for the devices
        of_config = {} if bench is None else bench.units_of(node_id, of_node)
        of_drive, without = _units(master, node_id, od, {**of_config, **given}, name, of_node)

        end_if_requested, next_s = on.enter_context(end_requests()), 0.0

        def alive() -> None:
            """Send this program's heartbeat when it is due. Raises KeyboardInterrupt once its end is requested."""
            nonlocal next_s
            end_if_requested()
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + _HEARTBEAT_S
                # Not as operational: that is a master whose SYNC will go on, for which simulated drives hold their
                # time.
                link.send([Frame(HEARTBEAT + MASTER_ID, NmtState.PRE_OPERATIONAL.heartbeat)])

        file = eds.name if bench is None and eds.is_file() else "its EDS file"
        manual = ManualDrive(master, node_id, name, of_drive, timeout, alive, of_node)
        by_hand = SetUpDrive(manual, file, _allowed(bench), without_units=without)
        if action in (Action.ENABLE, Action.DISABLE, Action.RESET):
            getattr(manual, action)()
        elif action is not Action.STATUS:
            _until_done(manual, _motion(by_hand, action, value, speed, relative, inf if duration is None else duration))
        _print(by_hand, as_json=json)


def _quantity(action: Action, value: str | None, own_unit: float) -> float:
    """VALUE in SI; `own_unit`: what one unit of the drive is. Raises UnusableInputError."""
    known = {**_UNITS[action], "units": own_unit}
    match = _QUANTITY.match(value or "")
    if match is None or match[2] not in known:
        found = "missing" if value is None else f"'{value}'"
        expected = f'expected a number with {", ".join(known)}, e.g. "{_EXAMPLES[action]}"'
        raise UnusableInputError("VALUE", f"{found}, {expected}")
    return float(match[1]) * known[match[2]]


def _method(value: str | None) -> int | None:
    """VALUE as a homing method. Raises UnusableInputError."""
    try:
        return None if value is None else int(value, 0)
    except ValueError:
        raise UnusableInputError("VALUE", f"'{value}', expected a homing method (6098h), e.g. 35") from None


def _units(
    master: Master, node_id: int, od: ObjectDictionary, given: Mapping[str, float], name: str, axis: int
) -> tuple[DriveUnits | None, str]:
    """Units as far as they are known, and the object that lacks them: without a rated torque (6076h) a torque is no
    number."""
    from hilbench.cia402.configuration import read_units

    problem = ""
    for known in (given, {"rated_torque_Nm": nan, **given}):
        try:
            return read_units(master, node_id, od, known, name, axis), ""
        except UnusableInputError as error:
            problem = f"{error.problem} (--units KEY=VALUE, or units: of the drive in --config)"
    return None, problem


def _given_units(texts: Sequence[str]) -> dict[str, float]:
    """Units of --units. Raises UnusableInputError."""
    expected = "position_rad, velocity_rad_s or rated_torque_Nm, and a number above 0: velocity_rad_s=0.10472"
    found = dict(key_and_number("--units", text, expected) for text in texts)
    for key, number in found.items():
        if key not in ("position_rad", "velocity_rad_s", "rated_torque_Nm") or number <= 0.0:
            raise UnusableInputError("--units", f"'{key}={number:g}', expected {expected}")
    return found


def _allowed(bench: ExperimentConfig | None) -> Limits:
    """The trip levels of a config that are a motor's."""
    from hilbench.cia402.set_up import Limits

    if bench is None:
        return Limits()
    limits = bench.safety.limits
    speed = limits.speed_rad_s.trip if bench.machine.position_unit == "rad" else None
    speed_rad_s, torque_Nm = (inf if each is None else each for each in (speed, limits.torque_Nm.trip))
    names = (f"safety: limits: {name}" for name in ("speed_rad_s", "torque_Nm"))
    return Limits((-inf, inf), speed_rad_s, torque_Nm, *names)


def _motion(
    by_hand: SetUpDrive, action: Action, value: str | None, speed_rad_s: float, relative: bool, duration_s: float
) -> Callable[[], object]:
    """Commanded action, of a drive that can do it. Raises UnusableInputError."""
    from hilbench.cia402.objects import OperationMode

    modes = {Action.MOVE: OperationMode.PROFILE_POSITION, Action.HOME: OperationMode.HOMING}
    modes[Action.TORQUE] = OperationMode.TORQUE
    units = by_hand.needs(modes.get(action, OperationMode.PROFILE_VELOCITY))
    match action:
        case Action.MOVE:
            return partial(by_hand.move, _quantity(action, value, units.position_rad), speed_rad_s, relative=relative)
        case Action.HOME:
            return partial(by_hand.home, _method(value))
        case Action.VELOCITY:
            return partial(by_hand.turn, _quantity(action, value, units.velocity_rad_s), duration_s)
        case Action.TORQUE:
            return partial(by_hand.push, _quantity(action, value, units.torque_Nm), duration_s, speed_rad_s)
    return partial(_jog, by_hand.drive, speed_rad_s)


def _until_done(manual: ManualDrive, motion: Callable[[], object]) -> None:
    """The drive is without power afterwards, by a quick stop if something ended it early."""
    from hilbench.apps.canopen_tools.attach import MASTER_ID

    # The drive watches from the first heartbeat on: from before the first motion until the power stage is off.
    with manual.watching(MASTER_ID, _HEARTBEAT_TIME_OUT_MS):
        try:
            motion()
        except BaseException:
            manual.quick_stop()
            raise
        manual.disable()


def _jog(manual: ManualDrive, speed_rad_s: float) -> None:
    """Hold-to-run until q."""
    with _keys() as key_pressed:
        manual.enable()
        print(f"hold {_FORWARD} (forward) or {_BACKWARD} (backward), q ends", file=sys.stderr, flush=True)
        _follow_keys(manual, key_pressed, speed_rad_s)
        manual.stop()


def _follow_keys(manual: ManualDrive, key_pressed: Callable[[float], str | None], speed_rad_s: float) -> None:
    from hilbench.cia402.manual import DeadManKey

    key, commanded = DeadManKey(), 0

    while True:
        manual.alive()
        pressed = key_pressed(_STEP_S)
        if pressed in _QUIT:
            return
        if pressed is not None:
            key.pressed({_FORWARD: 1, _BACKWARD: -1}.get(pressed, 0), time.monotonic())
        wanted = key.held(time.monotonic())
        if wanted != commanded:
            commanded = wanted
            manual.turn(wanted * speed_rad_s)


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


def _print(by_hand: SetUpDrive, *, as_json: bool) -> None:
    from hilbench.cia402.set_up import mode_name, usable

    status, modes = by_hand.drive.status(), usable(by_hand)
    if as_json:
        lacking = {mode_name(mode): list(missing) for mode, missing in modes.items()}
        print_json({**vars(status), "lacking": lacking})
        return
    print(f"{status.state}  (statusword {status.statusword:04X}h: {', '.join(status.flags) or 'no flags'})")
    of_drive = "-" if status.mode is None else str(status.mode)
    print(f"mode {of_drive}, error code {'-' if status.error_code is None else f'{status.error_code:04X}h'}")
    print(", ".join(text for text in _actual_values(status) if text) or "neither position, velocity nor torque")
    if by_hand.without_units:
        print(f"its units are not known: {by_hand.without_units}")
    for mode, missing in modes.items():
        if missing:
            print(f"{mode_name(mode)} can't be used: {', '.join(missing)}")


def _actual_values(status: DriveStatus) -> Iterator[str]:
    """Actual values in SI, and in the drive's units."""
    for value, units, name in (
        (status.position_rad, status.position_units, "rad"),
        (status.velocity_rad_s, status.velocity_units, "rad/s"),
        (status.torque_Nm, status.torque_units, "N·m"),
    ):
        if units is not None:
            yield f"{units} units" if value is None else f"{value:.5g} {name} ({units} units)"
