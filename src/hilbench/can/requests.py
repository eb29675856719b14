"""Requests to the hub of the embedded bus, checked: nothing a client sends can upset the hub."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from hilbench.can.disturbance import ErrorInjection
from hilbench.can.protocol import DEFAULT_BITRATE, DEFAULT_DATA_BITRATE

_MAX_FILTERS = 512  # as CAN_RAW_FILTER_MAX

#: (identifier, mask) of the frames that a station receives; None: all.
Filters = list[tuple[int, int]] | None


class RefusedError(Exception):
    """A request that is not carried out; its text is sent to the client."""


@dataclass(frozen=True)
class Settings:
    """Settings of the emulated bus: bit rates in bit/s; timing "real" or "virtual"."""

    bitrate: int = DEFAULT_BITRATE
    data_bitrate: int = DEFAULT_DATA_BITRATE
    timing: str = "real"


@dataclass(frozen=True)
class Wanted:
    """Settings that a client requests; None: any."""

    bitrate: int | None = None
    data_bitrate: int | None = None
    timing: str | None = None

    def completed(self) -> Settings:
        return Settings(**{name: value for name, value in asdict(self).items() if value is not None})

    def check_against(self, settings: Settings) -> None:
        """Raise RefusedError unless a bus with these settings is as the client requested."""
        for name, unit in (("bitrate", " bit/s"), ("data_bitrate", " bit/s"), ("timing", "")):
            running, wanted = getattr(settings, name), getattr(self, name)
            if wanted is not None and wanted != running:
                raise RefusedError(f"{name} is {running}{unit} on the bus that runs, asked for {wanted}{unit}")


def parse(packet: bytes) -> tuple[str, dict[str, Any]]:
    """Name and arguments of the request in a packet. Raises RefusedError, with what was expected."""
    try:
        content = json.loads(packet)
    except (ValueError, RecursionError):
        raise RefusedError("found no JSON, expected a request") from None
    if not isinstance(content, dict):
        raise RefusedError("found no object, expected a request")
    kind = content.pop("request", None)
    if kind == "join":
        return kind, _join(content)
    if kind == "set_filters":
        return kind, {"station": _integer(content, "station", 1), "filters": _filters(content.get("filters"))}
    if kind == "set_errors":
        return kind, {"injection": _injection(content)}
    if kind == "set_priority":
        return kind, {"priority": _integer(content, "priority", 1, 99)}
    if kind == "statistics":
        return kind, {}
    raise RefusedError(f"request {kind!r}: unknown")


def _join(content: dict[str, Any]) -> dict[str, Any]:
    timing = content.get("timing")
    if timing not in (None, "real", "virtual"):
        raise RefusedError(f"timing: found {timing!r}, expected 'real' or 'virtual'")
    wanted = Wanted(
        None if content.get("bitrate") is None else _integer(content, "bitrate", 1000, 1_000_000),
        None if content.get("data_bitrate") is None else _integer(content, "data_bitrate", 1000, 20_000_000),
        timing,
    )
    flags = {name: content.get(name) is True for name in ("receive_own", "fd", "single")}
    return {"wanted": wanted, "filters": _filters(content.get("filters")), **flags}


def _injection(content: dict[str, Any]) -> ErrorInjection:
    filters = _filters(content.pop("filters", None))
    try:
        for name, value in content.items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise RefusedError(f"{name}: found {value!r}, expected a number")
        content["seed"] = int(content.get("seed", 0))
        return ErrorInjection(**content, filters=None if filters is None else tuple(filters))
    except (TypeError, ValueError, OverflowError) as error:
        raise RefusedError(f"error injection: {error}") from None


def _integer(content: dict[str, Any], name: str, least: int, most: int = 1 << 62) -> int:
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise RefusedError(f"{name}: found {value!r}, expected an integer from {least} to {most}")
    return value


def _filters(content: Any) -> Filters:
    if content is None:
        return None
    if not isinstance(content, list) or len(content) > _MAX_FILTERS:
        raise RefusedError(f"filters: expected a list of up to {_MAX_FILTERS} pairs")
    for pair in content:
        if not (isinstance(pair, list) and len(pair) == 2 and all(type(part) is int for part in pair)):
            raise RefusedError(f"filters: found {pair!r}, expected [identifier, mask]")
    return [(identifier & 0xFFFFFFFF, mask & 0xFFFFFFFF) for identifier, mask in content]
