"""`hilbench doctor`: a machine, its interfaces and nodes examined."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from hilbench.apps.cli.config_file import load_config
from hilbench.apps.cli.options import BusOption, JsonOption, PaceOption, SetOption
from hilbench.errors import UnusableInputError


def doctor(
    config: Annotated[Path | None, Argument(metavar="[CONFIG]", help="bench config (YAML)")] = None,
    bus: BusOption = None,
    pace: PaceOption = None,
    changes: SetOption = None,
    start: Annotated[bool, Option(help="start simulated hardware and twin when they don't run, as run does")] = True,
    json: JsonOption = False,
) -> None:
    """Examine machine, CAN interface and nodes; says what is wrong and what to type. Writes nothing to any device.

    Exit code: 0 no error found (warnings may be), 1 errors found, 2 unusable input.

    Example: hilbench doctor bench_configs/web_section_step.yaml --bus socketcan:can0
    """
    from hilbench.apps.doctor.show import doctor_command
    from hilbench.can.open import BusAddress

    if config is None and changes:
        raise UnusableInputError("--set", f"'{changes[0]}' without a config, expected CONFIG to change")
    loaded = None if config is None else load_config(config, bus=bus, pace=pace, changes=changes or ())
    address = None
    if loaded is not None:
        address = loaded.config.bus_address
    elif bus is not None:
        address = BusAddress.parse(bus).as_it_runs()
    raise typer.Exit(doctor_command(loaded, address, start=start, as_json=json))
