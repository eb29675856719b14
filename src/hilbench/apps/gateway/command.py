"""`hilbench gateway`: programs that speak no CANopen talk to a bus by lines of text."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

from typer import Option

from hilbench.apps.cli.options import BusOption, ConfigOption, ForceOption
from hilbench.errors import UnusableInputError

if TYPE_CHECKING:
    from hilbench.apps.gateway.server import Gateway
    from hilbench.apps.gateway.session import Session


#: Port of a CiA 309 gateway in CANopenNode's and others' examples; no number is assigned.
_PORT = 60000


def gateway(
    config: ConfigOption = None,
    bus: BusOption = None,
    host: Annotated[str, Option(help="address to serve; every client that reaches it has its rights")] = "127.0.0.1",
    port: Annotated[int, Option(min=0, max=65535, help="0: a free one")] = _PORT,
    read_only: Annotated[bool, Option("--read-only", help="clients may read, and change nothing")] = False,
    force: ForceOption = False,
) -> None:
    """Serve a bus to other programs (LabVIEW, MATLAB, a shell): CiA 309-3, the ASCII mapping, over TCP.

    Beside a master (a running bench) clients may read; of the bench they may write what it has for its operator, its
    node's objects. Boot-ups and EMCY are told to all.

    Example: hilbench gateway --bus socketcan:can0
    """
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.apps.gateway.session import GatewayNetwork, Session
    from hilbench.processes import stop_request

    with BusSession(config, bus) as on:
        not_master, stop = "the gateway is read-only" if read_only else None, stop_request()
        try:
            if not read_only:
                on.be_only_master("gateway", force=force)
        except UnusableInputError as error:
            not_master = f"clients may only read: {error}"
        network = on.enter_context(GatewayNetwork(on.bus, not_master, -1 if read_only else on.master_id))
        server = _listening(host, port, lambda: Session(network, network.lss))
        on.callback(server.server_close)
        link = on.link()
        threading.Thread(target=server.serve_forever, name="gateway", daemon=True).start()
        on.callback(server.shutdown)
        where = ":".join(map(str, server.server_address[:2]))
        print(f"{on.bus} is served at {where} (CiA 309-3); {not_master or 'clients may write'}", flush=True)
        server.follow(link, stop)


def _listening(host: str, port: int, new_session: Callable[[], Session]) -> Gateway:
    from hilbench.apps.gateway.server import Gateway

    try:
        return Gateway((host, port), new_session)
    except OSError as error:
        raise UnusableInputError(
            "--host, --port", f"{host}:{port} can't be served ({error.strerror}), expected an address of this machine"
        ) from error
