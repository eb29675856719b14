"""The bus as the gateway's clients may use it, and one client's requests."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import astuple
from importlib.metadata import version
from typing import Final

from hilbench.apps.gateway import requests
from hilbench.apps.gateway.requests import GatewayError, Request, RequestError, form
from hilbench.can.open import BusAddress, open_python_can
from hilbench.canopen.identifiers import LAST_NODE, NmtCommand
from hilbench.canopen.lss_master import LssMaster
from hilbench.canopen.master import Identity, Master
from hilbench.canopen.sdo_client import SdoAbortedError, SdoCommunicationError
from hilbench.errors import BenchFaultError, BusError

_SDO_TIMEOUT_S: Final = 1.0
#: The only network that the gateway is in.
NET: Final = 1

_NMT: Final = {
    "start": NmtCommand.START,
    "stop": NmtCommand.STOP,
    "preop": NmtCommand.ENTER_PRE_OPERATIONAL,
    "preoperational": NmtCommand.ENTER_PRE_OPERATIONAL,
}
_RESETS: Final = {
    "node": NmtCommand.RESET_NODE,
    "comm": NmtCommand.RESET_COMMUNICATION,
    "communication": NmtCommand.RESET_COMMUNICATION,
}
_TIMED_OUT: Final = "0x05040000"


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


class Session:
    """Handles lines of one client. Default net and node are its own (CiA 309-3: set network, set node)."""

    def __init__(self, network: GatewayNetwork, lss: Callable[[], LssMaster]) -> None:
        self._network, self._lss = network, lss
        self._default_node: int | None = None
        self._commands: dict[str, Callable[[Request], str]] = {
            **dict.fromkeys(("r", "read"), self._read),
            **dict.fromkeys(("w", "write"), self._write),
            "reset": self._reset,
            "set": self._set,
            "info": self._info,
            "lss_switch_glob": self._lss_switch_global,
            "lss_switch_sel": self._lss_select,
            "lss_set_node": self._lss_set_node,
            "lss_conf_bitrate": self._lss_bit_rate,
            "lss_store": lambda _: self._lss_done(lambda lss: lss.store(), GatewayError.LSS_STORE),
            "lss_get_node": self._lss_get_node,
            "_lss_fastscan": self._lss_fast_scan,
            **dict.fromkeys(_NMT, lambda request: self._command(request, _NMT[request.words[0]])),
        }

    def answer(self, line: str) -> str | None:
        """The line that answers a line, without its end; None: nothing is answered."""
        sequence = requests.sequence_of(line)
        try:
            request = requests.parse(line)
            return None if request is None else f"[{request.sequence}] {self._handle(request)}"
        except RequestError as error:
            return f"[{sequence or 0}] ERROR:{error.code} # {error.comment}"

    def _handle(self, request: Request) -> str:
        command = self._commands.get(request.words[0])
        if command is None:
            raise RequestError(GatewayError.NOT_SUPPORTED, f"'{request.words[0]}' is not supported")
        if request.net not in (None, NET):
            raise RequestError(GatewayError.UNSUPPORTED_NET, f"net {request.net}, expected {NET}")
        try:
            return command(request)
        except SdoAbortedError as error:
            words = SdoAbortedError.CODES.get(error.code, "unknown code")
            raise RequestError(f"0x{error.code:08X}", words) from error
        except SdoCommunicationError as error:
            raise RequestError(_TIMED_OUT, "SDO protocol timed out") from error
        except BusError as error:
            raise RequestError(GatewayError.STATE, str(error)) from error

    # -- SDO ---------------------------------------------------------------------------------------------

    def _read(self, request: Request) -> str:
        node = self._node(request)
        index, sub = request.number(1, 0xFFFF), request.number(2, 0xFF)
        shown = form(request.words[3] if len(request.words) > 3 else "hex")
        return shown.show(self._network.upload(node, index, sub))

    def _write(self, request: Request) -> str:
        node = self._node(request)
        if len(request.words) < 5:
            raise RequestError(GatewayError.SYNTAX, "write: expected index, sub-index, data type and value")
        index, sub = request.number(1, 0xFFFF), request.number(2, 0xFF)
        data = form(request.words[3]).parse(" ".join(request.words[4:]))
        self._may_change(node)
        self._network.download(node, index, sub, data)
        return "OK"

    # -- NMT ---------------------------------------------------------------------------------------------

    def _reset(self, request: Request) -> str:
        what = request.words[1].lower() if len(request.words) > 1 else ""
        if what not in _RESETS:
            raise RequestError(GatewayError.SYNTAX, f"reset '{what}', expected node or comm")
        return self._command(request, _RESETS[what])

    def _command(self, request: Request, command: NmtCommand) -> str:
        node = self._node(request, all_nodes=True)
        self._may_change(0)
        self._network.nmt(command, node)
        return "OK"

    # -- the session -------------------------------------------------------------------------------------

    def _set(self, request: Request) -> str:
        what = request.words[1].lower() if len(request.words) > 1 else ""
        if what == "network":
            if request.number(2) != NET:
                raise RequestError(GatewayError.UNSUPPORTED_NET, f"net {request.words[2]}, expected {NET}")
        elif what == "node":
            self._default_node = self._checked(request.number(2), all_nodes=False)
        else:
            raise RequestError(GatewayError.NOT_SUPPORTED, f"set '{what}' is not supported")
        return "OK"

    def _info(self, request: Request) -> str:
        if request.words[1:] != ["version"]:
            raise RequestError(GatewayError.SYNTAX, "info: expected version")
        release = version("hilbench")
        # Vendor-ID, product code, revision, serial number, class, version of the protocol, of the gateway
        return f"0 0 0 0 2 2.1 {release}"

    def _node(self, request: Request, *, all_nodes: bool = False) -> int:
        node = self._default_node if request.node is None else request.node
        if node is None:
            raise RequestError(GatewayError.NO_DEFAULT_NODE, "no node is named, and none was set (set node)")
        return self._checked(node, all_nodes=all_nodes)

    def _checked(self, node: int, *, all_nodes: bool) -> int:
        least = 0 if all_nodes else 1
        if not least <= node <= LAST_NODE:
            raise RequestError(GatewayError.UNSUPPORTED_NODE, f"node {node}, expected {least} to {LAST_NODE}")
        return node

    def _may_change(self, node_id: int) -> None:
        why_not = self._network.why_not(node_id)
        if why_not is not None:
            raise RequestError(GatewayError.STATE, why_not)

    # -- LSS ---------------------------------------------------------------------------------------------

    def _lss_done(self, do: Callable[[LssMaster], None], error_code: GatewayError) -> str:
        self._may_change(0)
        try:
            do(self._lss())
        except BenchFaultError as error:
            code = GatewayError.TIMED_OUT if "no answer" in str(error) else error_code
            raise RequestError(code, str(error)) from error
        return "OK"

    def _lss_switch_global(self, request: Request) -> str:
        if request.number(1, 1) == 1:
            raise RequestError(GatewayError.NOT_SUPPORTED, "all devices at once; expected 0, or lss_switch_sel")
        return self._lss_done(lambda lss: lss.release(), GatewayError.LSS_MANUFACTURER)

    def _lss_select(self, request: Request) -> str:
        identity = Identity(*(request.number(place) for place in range(1, 5)))
        return self._lss_done(lambda lss: lss.select(identity), GatewayError.LSS_MEDIA)

    def _lss_set_node(self, request: Request) -> str:
        node_id = request.number(1, 0xFF)
        return self._lss_done(lambda lss: lss.give_node_id(node_id), GatewayError.LSS_NODE_ID)

    def _lss_bit_rate(self, request: Request) -> str:
        table, index = (0, request.number(1)) if len(request.words) == 2 else (request.number(1), request.number(2))
        if table != 0 or index not in (0, 1, 2, 3, 4, 6, 7, 8):
            raise RequestError(GatewayError.LSS_BIT_RATE, f"bit rate {index} of table {table}")
        return self._lss_done(lambda lss: lss.give_bit_rate(index), GatewayError.LSS_BIT_RATE)

    def _lss_get_node(self, _request: Request) -> str:
        found: list[int | None] = []
        self._lss_done(lambda lss: found.append(lss.node_id()), GatewayError.LSS_MANUFACTURER)
        return str(found[0] or 255)

    def _lss_fast_scan(self, _request: Request) -> str:
        found: list[Identity] = []
        self._lss_done(lambda lss: found.extend(lss.find_unconfigured()), GatewayError.LSS_MANUFACTURER)
        if not found:
            raise RequestError(GatewayError.TIMED_OUT, "no device without a node id answers")
        return " ".join(f"0x{number:08X}" for number in astuple(found[0]))
