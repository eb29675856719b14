"""Which identifiers CiA 301 leaves to configuration (table 40, "restricted CAN-IDs")."""

from __future__ import annotations

_RESERVED_BITS = 0x3FFFF800  #: 29-bit identifiers and the frame bit: this runtime speaks 11-bit identifiers only


def is_restricted(cob_id: int) -> bool:
    """Whether an object other than NMT, SDO, heartbeat, SYNC and TIME must not take this COB-ID."""
    identifier = cob_id & 0x7FF
    return (
        bool(cob_id & _RESERVED_BITS)
        or identifier <= 0x080
        or 0x101 <= identifier <= 0x180
        or 0x581 <= identifier <= 0x5FF
        or 0x601 <= identifier <= 0x67F
        or 0x6E0 <= identifier <= 0x6FF
        or identifier >= 0x701
    )
