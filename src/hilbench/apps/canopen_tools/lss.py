"""`hilbench lss`: node ids and bit rates of devices that have none, or the wrong ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from hilbench.apps.cli.options import BusOption, ForceOption
from hilbench.errors import BenchFaultError, UnusableInputError

if TYPE_CHECKING:
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.can.open import BusAddress
    from hilbench.canopen.lss_master import LssMaster
    from hilbench.canopen.master import Identity

app = typer.Typer(help="Node id and bit rate of a device by LSS (CiA 305).", no_args_is_help=True)

_BOOT_S = 5.0
IdentityOption = Annotated[
    str | None,
    Option(
        "--identity",
        metavar="VENDOR:PRODUCT:REVISION:SERIAL",
        help="of the device, 1018h, decimal or hexadecimal (2Ah, 0x2A)",
        show_default="the only device without a node id",
    ),
]
TimeoutOption = Annotated[
    float, Option("--timeout", min=0.005, metavar="S", help="within which a device answers a request")
]


@app.command("assign")
def assign(
    node_id: Annotated[int, Argument(metavar="NODE_ID", min=1, max=127)],
    identity: IdentityOption = None,
    bit_rate: Annotated[int | None, Option(metavar="KBIT/S", help="bit rate from its next start on")] = None,
    store: Annotated[bool, Option(help="kept over a loss of power")] = True,
    bus: BusOption = None,
    timeout_s: TimeoutOption = 0.1,
    force: ForceOption = False,
) -> None:
    """Give a device a node id, and wait until it has booted with it.

    Exit code: 0 it is there with the id, 2 the id is in use or several devices could be meant, 3 no answer or refused.

    Example: hilbench lss assign 5 --bus socketcan:can0

    Example: hilbench lss assign 5 --identity 2Ah:402h:10000h:7 --bit-rate 500 --bus socketcan:can0
    """
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.can.open import open_python_can
    from hilbench.canopen.sdo_client import SdoClient

    wanted = None if identity is None else _identity(identity)
    rate_index = None if bit_rate is None else _bit_rate_index(bit_rate)
    with BusSession(None, bus) as on:
        master = _master(on, timeout_s, f"lss assign {node_id}", force=force)
        with SdoClient(open_python_can(on.bus), 0.2) as reader:
            if reader.read(node_id, 0x1000) is not None:
                raise UnusableInputError(
                    "NODE_ID", f"node {node_id} answers already on {on.bus}, expected an id not in use"
                )
        wanted = wanted or _only_unconfigured(master, on.bus)
        master.select(wanted)
        before = master.node_id()
        if rate_index is not None:  # where it is refused the device has not got a node id yet
            master.give_bit_rate(rate_index)
        master.give_node_id(node_id)
        if store:
            master.store()
        if not master.boots(node_id, old_id=before, timeout_s=_BOOT_S):
            raise BenchFaultError(f"{words(wanted)} took node id {node_id}, but did not boot with it in {_BOOT_S:g} s")
    kept = "stored" if store else "not stored"
    print(f"node {node_id}: {words(wanted)}, {'no node id' if before is None else f'node {before}'} before; {kept}")


@app.command("show")
def show(bus: BusOption = None, timeout_s: TimeoutOption = 0.1, force: ForceOption = False) -> None:
    """Who is the only device on a bus, and which node id it has: with one cable and one device nothing more is needed.

    Example: hilbench lss show --bus socketcan:can0
    """
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.canopen.lss_master import shown

    with BusSession(None, bus) as on:
        master = _master(on, timeout_s, "lss show", force=force)
        found = master.select_only_one()
        node_id = master.node_id()
    print(f"{words(found)}: {'no node id' if node_id is None else f'node {node_id}'}; --identity {shown(found)}")


def _master(on: BusSession, timeout_s: float, what: str, *, force: bool) -> LssMaster:
    from hilbench.can.open import open_python_can
    from hilbench.canopen.lss_master import LssMaster

    on.be_only_master(what, force=force)
    return on.enter_context(LssMaster(open_python_can(on.bus), timeout_s))


def _only_unconfigured(master: LssMaster, address: BusAddress) -> Identity:
    from hilbench.canopen.lss_master import shown

    found = master.find_unconfigured()
    if not found:
        raise BenchFaultError(f"no device without a node id answers on {address}")
    if len(found) > 1:
        raise UnusableInputError(
            "--identity", f"missing, {len(found)} devices have no node id: {', '.join(map(shown, found))}; expected one"
        )
    return found[0]


def _bit_rate_index(kbit_s: int) -> int:
    from hilbench.canopen.lss_slave import BIT_RATES

    known = {rate // 1000: index for index, rate in BIT_RATES.items()}
    if kbit_s not in known:
        raise UnusableInputError("--bit-rate", f"{kbit_s} kbit/s, expected one of {', '.join(map(str, sorted(known)))}")
    return known[kbit_s]


def _identity(text: str) -> Identity:
    from hilbench.canopen.master import Identity

    parts = text.split(":")
    try:
        numbers = [int(part[:-1], 16) if part[-1:] in "hH" else int(part, 0) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(0 <= number < 1 << 32 for number in numbers):
        raise UnusableInputError(
            "--identity", f"'{text}', expected VENDOR:PRODUCT:REVISION:SERIAL, as 2Ah:402h:10000h:7"
        )
    return Identity(*numbers)


def words(identity: Identity) -> str:
    """Identity of a device, for a person."""
    return (
        f"device {identity.vendor_id:X}h/{identity.product_code:X}h revision {identity.revision_number:X}h, "
        f"serial number {identity.serial_number}"
    )
