"""`hilbench boot`: a network as its master's DCF describes it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from hilbench.apps.cli.options import BusOption, ForceOption, JsonOption, print_json
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_CRITERION_FAILED, EXIT_PASSED

if TYPE_CHECKING:
    from hilbench.canopen.network_boot import Booted

_SDO_TIMEOUT_S = 0.3


def boot(
    file: Annotated[Path, Argument(metavar="MASTER_DCF", help="DCF of the NMT master (1F80h ff.)")],
    bus: BusOption = None,
    timeout_s: Annotated[
        float, Option("--timeout", min=0.1, metavar="S", help="for a node to answer, where 1F89h does not tell")
    ] = 5.0,
    json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Boot a network as CiA 302-2 has it: check who is there, write each node's concise DCF (1F22h), start them.

    A mandatory node that is missing, is another device or can't be configured keeps all from being started.

    Exit code: 0 all there and started, 1 nodes that are not mandatory failed, 3 a mandatory one failed.

    Example: hilbench boot network/master.dcf --bus socketcan:can0
    """
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.canopen.network_boot import boot_network, read_plan

    plan = read_plan(file)
    with BusSession(None, bus) as on:
        on.be_only_master(f"boot {file.name}", force=force)
        found = boot_network(
            on.master(_SDO_TIMEOUT_S), plan, timeout_s, lambda booted: None if json else print(_line(booted))
        )
    failed = [booted for booted in found if booted.error is not None]
    mandatory = any(booted.slave.mandatory for booted in failed)
    if json:
        print_json({"nodes": [_as_data(booted) for booted in found], "started": not mandatory})
    elif mandatory:
        print("no node was started: a mandatory one is not as it should be")
    raise typer.Exit(EXIT_BENCH_FAULT if mandatory else EXIT_CRITERION_FAILED if failed else EXIT_PASSED)


def _line(booted: Booted) -> str:
    slave = booted.slave
    if booted.error is not None:
        kind = "mandatory" if slave.mandatory else "optional"
        return f"node {slave.node_id} ({kind}): error status {booted.error}: {booted.reason}"
    if not slave.boots:
        return f"node {slave.node_id}: there, as expected; not started (1F81h bit 2)"
    return f"node {slave.node_id}: as expected, {len(slave.configuration)} objects written"


def _as_data(booted: Booted) -> dict[str, Any]:
    return {
        "node": booted.slave.node_id,
        "mandatory": booted.slave.mandatory,
        "error_status": booted.error,
        "reason": booted.reason,
        "written": booted.slave.configuration,
    }
