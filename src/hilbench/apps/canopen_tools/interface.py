"""Kernel data of a CAN network interface: from ``ip`` (iproute2, netlink) and /sys/class/net."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hilbench.can.interfaces import ARPHRD_CAN, IFF_UP, SYSFS, number_in

if TYPE_CHECKING:
    from hilbench.can.open import BusAddress

_IP_TIMEOUT_S = 5.0

#: Counters that stay at zero on a sound bus (arbitration that was lost is no error), as `ip` names them.
_CONTROLLER_COUNTERS = ("bus_error", "error_warning", "error_passive", "bus_off", "restarts")
_RECEIVE_COUNTERS = ("errors", "dropped", "over_errors")
_TRANSMIT_COUNTERS = ("errors", "dropped", "carrier_errors")


@dataclass(frozen=True)
class InterfaceFacts:
    """One interface; None where the kernel does not say (a vcan has no bit rate, state or error counters)."""

    name: str
    exists: bool = True
    is_can: bool = True
    up: bool = False
    detailed: bool = True  #: False: `ip` (iproute2) is not there, only /sys was read
    kind: str = ""  #: can, vcan, ...
    queue_length: int | None = None
    queued: bool = True  #: False: frames go to the driver without a queue (vcan)
    bitrate: int | None = None  #: bit/s
    state: str | None = None  #: ERROR-ACTIVE, ERROR-WARNING, ERROR-PASSIVE, BUS-OFF, STOPPED or SLEEPING
    transmit_errors: int | None = None  #: the controller's error counters, 0 to 255
    receive_errors: int | None = None
    restart_ms: int | None = None  #: 0: stays off the bus after bus-off
    modes: tuple[str, ...] = ()  #: LISTEN-ONLY, LOOPBACK, ONE-SHOT, ...
    counters: Mapping[str, int] = field(default_factory=dict)  #: of errors since the driver was loaded, by name


def parse_ip_link(text: str) -> InterfaceFacts:
    """The facts in the answer to ``ip -details -statistics -json link show dev NAME``."""
    link: dict[str, Any] = next(entry for entry in json.loads(text) if entry)
    info: dict[str, Any] = link.get("linkinfo", {})
    data: dict[str, Any] = info.get("info_data", {})
    errors: dict[str, Any] = data.get("berr_counter", {})
    return InterfaceFacts(
        name=link["ifname"],
        is_can=link.get("link_type") == "can",
        up="UP" in link.get("flags", []),
        kind=info.get("info_kind", ""),
        queue_length=link.get("txqlen"),
        queued=link.get("qdisc") != "noqueue",
        bitrate=data.get("bittiming", {}).get("bitrate"),
        state=data.get("state"),
        transmit_errors=errors.get("tx"),
        receive_errors=errors.get("rx"),
        restart_ms=data.get("restart_ms"),
        modes=tuple(data.get("ctrlmode", [])),
        counters=_counters(info.get("info_xstats", {}), link.get("stats64", {})),
    )


def _counters(controller: Mapping[str, int], statistics: Mapping[str, Mapping[str, int]]) -> dict[str, int]:
    received, sent = statistics.get("rx", {}), statistics.get("tx", {})
    return (
        {name: controller[name] for name in _CONTROLLER_COUNTERS if name in controller}
        | {f"rx_{name}": received[name] for name in _RECEIVE_COUNTERS if name in received}
        | {f"tx_{name}": sent[name] for name in _TRANSMIT_COUNTERS if name in sent}
    )


def read_sysfs(name: str, root: Path = SYSFS) -> InterfaceFacts:
    """Read /sys/class/net; little, but always there."""
    folder = root / name
    if not folder.is_dir():
        return InterfaceFacts(name, exists=False)
    return InterfaceFacts(
        name,
        is_can=number_in(folder / "type") == ARPHRD_CAN,
        up=bool(number_in(folder / "flags") & IFF_UP),
        detailed=False,
        queue_length=number_in(folder / "tx_queue_len"),
    )


def read_interface(name: str) -> InterfaceFacts:
    """Read the kernel's data of an interface; where `ip` is missing, or too old for JSON, those of /sys."""
    facts = read_sysfs(name)
    if not facts.exists:
        return facts
    command = ["ip", "-details", "-statistics", "-json", "link", "show", "dev", name]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=_IP_TIMEOUT_S, check=False)
        return parse_ip_link(answer.stdout)
    except (FileNotFoundError, subprocess.TimeoutExpired, ValueError, KeyError, StopIteration):
        return facts


def bitrate_of(bus: BusAddress) -> int:
    """Bit rate of an interface that reports it, in bit/s; else the address's."""
    known_bitrate = read_interface(bus.channel).bitrate if bus.interface == "socketcan" else None
    return known_bitrate or bus.bitrate
