"""Master side of the layer setting services (CiA 305): canopen's, completed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import astuple
from typing import Final, Self

from canopen.lss import CS_INQUIRE_SERIAL_NUMBER, CS_INQUIRE_VENDOR_ID, LssError

from hilbench.can.python_can import can
from hilbench.canopen.identifiers import HEARTBEAT, NMT, NmtCommand
from hilbench.canopen.lss_slave import BIT_RATES, UNCONFIGURED
from hilbench.canopen.master import Identity
from hilbench.canopen.sdo_client import Network
from hilbench.errors import BenchFaultError, BusError, one_line

_MOST_DEVICES: Final = 127
#: canopen's errors for a person.
_REASONS: Final = {
    "LSS Error: 1": "it refuses it",
    "LSS Error: 2": "it could not be stored",
    "No LSS response received": "no answer",
    "Response message is not for the request": "several devices answer",
}


class LssMaster:
    """Finds devices without a node id, and gives devices node ids and bit rates.

    `timeout_s`: within that a device answers; a fast scan waits as long for each bit of an address that is 1. Takes
    the bus over, and closes it.
    """

    def __init__(self, bus: can.BusABC, timeout_s: float = 0.1) -> None:
        self._network = Network(bus)
        self._network.lss.RESPONSE_TIMEOUT = timeout_s
        self._network.connect()

    def find_unconfigured(self) -> list[Identity]:
        """All devices without a node id, lowest LSS address first, by fastscan; nothing of them is changed.

        Some (CANopenNode, npm's canopen) answer a fastscan again after they were found: then it is the last that is
        found, and those behind it are once it has its node id.
        """
        found: list[Identity] = []
        with self._talking("scanning for devices without a node id"):
            self._leave_configuration()
            while len(found) < _MOST_DEVICES:
                there, numbers = self._network.lss.fast_scan()
                if not there:
                    break
                identity = Identity(*numbers)
                if identity in found:
                    break
                found.append(identity)  # who was found waits no more, and takes no part in the next scan
            self._leave_configuration()
        return found

    def select(self, identity: Identity) -> None:
        """Bring this device, alone, into its configuration state. Raises BenchFaultError when it does not answer."""
        with self._talking(f"device {shown(identity)}"):
            self._leave_configuration()
            self._network.lss.send_switch_state_selective(*astuple(identity))

    def select_only_one(self) -> Identity:
        """Bring the only device on the bus, whatever it is, into configuration state, and inquire its identity."""
        with self._talking("the only device of the bus"):
            self._network.lss.send_switch_state_global(self._network.lss.CONFIGURATION_STATE)
            services = range(CS_INQUIRE_VENDOR_ID, CS_INQUIRE_SERIAL_NUMBER + 1)
            return Identity(*(self._network.lss.inquire_lss_address(service) for service in services))

    def node_id(self) -> int | None:
        """Node id of the selected device; None: it has none."""
        with self._talking("its node id"):
            node_id = self._network.lss.inquire_node_id()
        return None if node_id in (0, UNCONFIGURED) else int(node_id)

    def give_node_id(self, node_id: int) -> None:
        """Configure the node id of the selected device. Raises BenchFaultError when it refuses it."""
        with self._talking(f"node id {node_id}"):
            self._network.lss.configure_node_id(node_id)

    def give_bit_rate(self, index: int) -> None:
        """Configure the bit rate of the selected device, by its index in table 0 (`lss_slave.BIT_RATES`); in force once
        stored and the device starts again. Raises BenchFaultError when the device refuses it.
        """
        with self._talking(f"bit rate {BIT_RATES[index] // 1000} kbit/s"):
            self._network.lss.configure_bit_timing(index)

    def store(self) -> None:
        """Store the configuration of the selected device. Raises BenchFaultError when it does not."""
        with self._talking("storing"):
            self._network.lss.store_configuration()

    def release(self) -> None:
        """All devices leave the configuration state; one that has a node id now for the first time boots."""
        with self._talking("leaving the configuration state"):
            self._leave_configuration()

    def boots(self, node_id: int, *, old_id: int | None, timeout_s: float) -> bool:
        """Activate the device's new node id, and wait for its boot-up message (or a heartbeat).

        One that had a node id is reset (NMT reset communication) under its old one.
        """
        seen: list[int] = []
        self._network.subscribe(HEARTBEAT + node_id, lambda can_id, _data, _time: seen.append(can_id))
        self.release()
        if old_id is not None:
            with self._talking(f"resetting node {old_id}"):
                self._network.send_message(NMT, NmtCommand.RESET_COMMUNICATION.to(old_id))
        deadline_s = time.monotonic() + timeout_s
        while not seen and time.monotonic() < deadline_s:
            time.sleep(0.01)
        return bool(seen)

    def close(self) -> None:
        """Leave the bus; selected devices return to waiting state."""
        with suppress(can.CanError, OSError):
            self._leave_configuration()
            self._network.disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _leave_configuration(self) -> None:
        self._network.lss.send_switch_state_global(self._network.lss.WAITING_STATE)

    @contextmanager
    def _talking(self, about: str) -> Iterator[None]:
        try:
            yield
        except LssError as error:
            raise BenchFaultError(f"LSS, {about}: {_REASONS.get(str(error), str(error))}") from error
        except (can.CanError, OSError) as error:
            raise BusError(one_line(error)) from error


def shown(identity: Identity) -> str:
    """Identity as given on the command line: vendor, product code, revision and serial number."""
    return ":".join(f"{number:X}h" for number in astuple(identity))
