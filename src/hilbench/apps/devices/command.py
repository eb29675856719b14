"""`hilbench simulate-drive`: drives of any EDS file on a bus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option


def simulate_drive(
    eds: Annotated[Path, Argument(metavar="EDS", help="EDS or DCF file of a CiA-402 drive")],
    node: Annotated[
        int | None, Option(min=1, max=127, help="node id, of the first of several", show_default="1; with --lss none")
    ] = None,
    bus: Annotated[
        str, Option(help="embedded:NAME, socketcan:vcan0, or another python-can interface:channel")
    ] = "embedded",
    count: Annotated[int, Option(min=1, max=127, help="so many drives, ids in a row")] = 1,
    plant: Annotated[Path | None, Option(help="model file or config of a servo_axis: what the motor turns")] = None,
    behaviour: Annotated[Path | None, Option(help="YAML file: switches, units, and what the drive does wrong")] = None,
    lss: Annotated[
        bool, Option("--lss", help="node ids can be given by LSS; without --node the drives wait for theirs")
    ] = False,
    serial: Annotated[
        int | None,
        Option(
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
    from hilbench.apps.devices.serve import behaviour_of, serve

    serve(eds, node, bus, count, behaviour_of(behaviour, plant), lss=lss, serial=serial)
