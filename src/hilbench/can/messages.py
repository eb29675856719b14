"""Conversion between python-can's messages and our frames."""

from __future__ import annotations

from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.python_can import can


def identifier_with_flags(message: can.Message) -> int:
    """The kernel's identifier word of a message."""
    can_id = int(message.arbitration_id)
    if message.is_extended_id:
        can_id |= EXTENDED_FLAG
    if message.is_remote_frame:
        can_id |= REMOTE_FLAG
    if message.is_error_frame:
        can_id |= ERROR_FLAG
    return can_id


def to_frame(message: can.Message) -> Frame:
    """The frame of a classical message; its timestamp as `time_ns`."""
    data = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    return Frame(identifier_with_flags(message), data, round(message.timestamp * 1e9))


def to_message(frame: Frame, channel: str, is_rx: bool = True) -> can.Message:
    """The message of a frame that was received on `channel`."""
    can_id = frame.can_id
    remote = bool(can_id & REMOTE_FLAG)
    extended = bool(can_id & EXTENDED_FLAG)
    return can.Message(
        timestamp=frame.time_ns * 1e-9,
        arbitration_id=can_id & (0x1FFFFFFF if extended else 0x7FF),
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=bool(can_id & ERROR_FLAG),
        channel=channel,
        dlc=len(frame.data),
        data=None if remote else frame.data,
        is_rx=is_rx,
    )


def kernel_filters(filters: can.typechecking.CanFilters | None) -> list[tuple[int, int]] | None:
    """python-can's filters as (identifier, mask) pairs with flag bits; as there, an empty list lets all pass."""
    if not filters:
        return None
    pairs = []
    for entry in filters:
        identifier, mask = int(entry["can_id"]), int(entry["can_mask"])
        if "extended" in entry:
            mask |= EXTENDED_FLAG
            identifier |= EXTENDED_FLAG if entry["extended"] else 0
        pairs.append((identifier, mask))
    return pairs
