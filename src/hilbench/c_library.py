"""C library functions for compiled code, from the library in the process; arrays are passed by address."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

#: <linux/time.h>
CLOCK_MONOTONIC: Final = 1
TIMER_ABSTIME: Final = 1
#: <linux/socket.h>
MSG_DONTWAIT: Final = 0x40
MSG_NOSIGNAL: Final = 0x4000
#: <linux/prctl.h>
PR_SET_TIMERSLACK: Final = 29

if TYPE_CHECKING:

    def recv(descriptor: int, buffer: int, length: int, flags: int) -> int:
        """recv(2)."""

    def send(descriptor: int, packet: int, length: int, flags: int) -> int:
        """send(2)."""

    def epoll_wait(epoll: int, events: int, most: int, timeout_ms: int) -> int:
        """epoll_wait(2)."""

    def prctl(option: int, first: int, second: int, third: int, fourth: int) -> int:
        """prctl(2)."""

    def clock_gettime(clock: int, time: int) -> int:
        """clock_gettime(2)."""

    def clock_nanosleep(clock: int, flags: int, time: int, remaining: int) -> int:
        """clock_nanosleep(2)."""

else:
    from numba import types

    recv = types.ExternalFunction("recv", types.intp(types.int32, types.intp, types.intp, types.int32))
    send = types.ExternalFunction("send", types.intp(types.int32, types.intp, types.intp, types.int32))
    epoll_wait = types.ExternalFunction("epoll_wait", types.int32(types.int32, types.intp, types.int32, types.int32))
    prctl = types.ExternalFunction("prctl", types.int32(types.int32, *4 * (types.uintp,)))
    clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))
    clock_nanosleep = types.ExternalFunction(
        "clock_nanosleep", types.int32(types.int32, types.int32, types.intp, types.intp)
    )
