"""The bus as the gateway's clients may use it."""

from __future__ import annotations

import threading
from typing import Final

from hilbench.can.open import BusAddress, open_python_can
from hilbench.canopen.lss_master import LssMaster
from hilbench.canopen.master import Master

_SDO_TIMEOUT_S: Final = 1.0


class GatewayNetwork(Master):
    """SDO, NMT and LSS on a bus; clients share it. `not_master`: why nothing may be written there, but to the node
    `bench_id`, whose objects are for operators; None: it may.
    """

    def __init__(self, bus: BusAddress, not_master: str | None, bench_id: int) -> None:
        super().__init__(open_python_can(bus), _SDO_TIMEOUT_S)
        self._address, self._not_master, self._bench_id = bus, not_master, bench_id
        self._lss: LssMaster | None = None
        self._lss_made = threading.Lock()

    def why_not(self, node_id: int) -> str | None:
        """Why nothing may be changed at a node (0: of the network); None: it may."""
        return None if node_id == self._bench_id else self._not_master

    def lss(self) -> LssMaster:
        """LSS, from the first client on who needs it."""
        with self._lss_made:
            if self._lss is None:
                self._lss = LssMaster(open_python_can(self._address))
            return self._lss

    def close(self) -> None:
        """Leave the bus."""
        if self._lss is not None:
            self._lss.close()
        super().close()
