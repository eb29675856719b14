"""Waiting for a file descriptor with the resolution a bus cycle needs."""

from __future__ import annotations

import select

_SELECT_LIMIT = 1024  # FD_SETSIZE


def wait_readable(descriptor: int, timeout_s: float) -> bool:
    """True if `descriptor` is readable, or becomes so within `timeout_s`.

    select() waits in microseconds, poll() and epoll in whole milliseconds, rounded up: half a cycle.
    """
    if descriptor < _SELECT_LIMIT:
        return bool(select.select([descriptor], [], [], max(timeout_s, 0.0))[0])
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(max(timeout_s, 0.0) * 1e3))


def wait_writable(descriptor: int, timeout_s: float) -> bool:
    """True if `descriptor` takes data, or does so within `timeout_s`."""
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return bool(poll.poll(timeout_s * 1e3))
