"""Last cycles of a bench that runs on a bus, as its recording will have them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final, Protocol

import numpy as np

from hilbench.bench.machines.ranges import OPERATOR_OBJECTS
from hilbench.bench.operator.operator_objects import INDEX
from hilbench.bench.prediction.create import foreseeable
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.data_types import DataType
from hilbench.canopen.identifiers import SYNC
from hilbench.canopen.sdo_client import SdoAbortedError, SdoCommunicationError
from hilbench.errors import UnusableInputError
from hilbench.results.recording import Recording
from hilbench.results.recover import replay_frames
from hilbench.topology.config import BenchConfig

#: SYNCs that are listened to, and for how long at most, s.
SYNCS: Final = 200
_LONGEST_S: Final = 5.0
_READ_S: Final = 0.05


class Reader(Protocol):
    """Reader of objects of other nodes (`hilbench.canopen.sdo_client.SdoClient`)."""

    def upload(self, node_id: int, index: int, sub: int) -> bytes:
        """The content of an object."""


def received(config: BenchConfig, link: Link, reader: Reader) -> Recording:
    """The last cycles of the bench that runs on this bus; its set points are read from its node.

    Raises UnusableInputError where none runs, or its drives are not enabled.
    """
    frames: list[Frame] = []
    syncs, until_s = 0, time.monotonic() + _LONGEST_S
    while syncs <= SYNCS and time.monotonic() < until_s:
        new = link.receive(_READ_S)
        frames += new
        syncs += sum(frame.can_id == SYNC for frame in new)
    return from_frames(config, frames, reader)


def from_frames(config: BenchConfig, frames: Sequence[Frame], reader: Reader) -> Recording:
    """Last cycles from frames received already, in their order. Raises as `received`."""
    place = f"bus {config.bus.address}"
    if not any(frame.can_id == SYNC for frame in frames):
        raise UnusableInputError(place, f"no SYNC within {_LONGEST_S:g} s, expected a bench that runs")
    return _with_asked(config, replay_frames(config, frames, None, place, begun=True).recording, reader)


def _with_asked(config: BenchConfig, recording: Recording, reader: Reader) -> Recording:
    """The recording with what no frame shows: set-points, E of the emulated web."""
    channels = dict(recording.channels)
    for path, signal in foreseeable(config).items():
        if path in OPERATOR_OBJECTS and np.isnan(channels[signal][-1]):
            try:
                data = reader.upload(config.master.node_id, INDEX, OPERATOR_OBJECTS[path][0])
            except (SdoAbortedError, SdoCommunicationError):
                continue  # the caller of such a signal gets the reason
            channels[signal] = np.full(len(recording.time_s), DataType.REAL32.decode(data))
    return Recording(channels)
