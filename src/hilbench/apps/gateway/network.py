"""The bus as the gateway's clients may use it."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from types import TracebackType
from typing import Final, Self

from hilbench.can.open import BusAddress, open_python_can
from hilbench.canopen.identifiers import NmtCommand
from hilbench.canopen.lss_master import LssMaster
from hilbench.canopen.master import Master

_SDO_TIMEOUT_S: Final = 1.0


class GatewayNetwork:
    """SDO, NMT and LSS on a bus; clients share it. `not_master`: why nothing may be written there, but to the node
    `bench_id`, whose objects are for operators; None: it may. Leave it as a context.
    """

    def __init__(self, bus: BusAddress, not_master: str | None, bench_id: int) -> None:
        self._bus, self._not_master, self._bench_id = bus, not_master, bench_id
        self._resources = ExitStack()
        self._master = Master(open_python_can(bus), _SDO_TIMEOUT_S)
        self._resources.callback(self._master.close)
        self._lss: LssMaster | None = None
        self._lock = threading.Lock()

    def upload(self, node_id: int, index: int, sub: int) -> bytes:
        """Read an object by `SdoClient.upload`."""
        return self._master.upload(node_id, index, sub)

    def download(self, node_id: int, index: int, sub: int, data: bytes) -> None:
        """Write an object by `SdoClient.download`."""
        self._master.download(node_id, index, sub, data)

    def nmt(self, command: NmtCommand, node_id: int = 0) -> None:
        """Send an NMT command by `Master.nmt`."""
        self._master.nmt(command, node_id)

    def why_not(self, node_id: int) -> str | None:
        """Why nothing may be changed at a node (0: of the network); None: it may."""
        return None if node_id == self._bench_id else self._not_master

    def lss(self) -> LssMaster:
        """LSS, from the first client on who needs it."""
        with self._lock:
            if self._lss is None:
                self._lss = self._resources.enter_context(LssMaster(open_python_can(self._bus)))
            return self._lss

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()
