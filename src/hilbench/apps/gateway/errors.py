"""Errors of requests that can't be done (CiA 309-3, internal error codes), or that a device aborts (SDO abort)."""

from __future__ import annotations

from enum import IntEnum


class GatewayError(IntEnum):
    """Error codes of the gateway itself."""

    NOT_SUPPORTED = 100
    SYNTAX = 101
    STATE = 102
    TIMED_OUT = 103
    NO_DEFAULT_NET = 104
    NO_DEFAULT_NODE = 105
    UNSUPPORTED_NET = 106
    UNSUPPORTED_NODE = 107
    HEARTBEAT_LOST = 203
    LSS_MANUFACTURER = 501
    LSS_NODE_ID = 502
    LSS_BIT_RATE = 503
    LSS_STORE = 504
    LSS_MEDIA = 505


class RequestError(Exception):
    """A request that ends with an error; `code` as it is sent, `comment` for a person."""

    def __init__(self, code: GatewayError | str, comment: str) -> None:
        super().__init__(comment)
        self.code = str(int(code)) if isinstance(code, GatewayError) else code
        self.comment = comment
