"""A recording as an MCAP file, as a stream of its run would have made it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hilbench.apps.streams.sinks import FoxgloveSink
from hilbench.files import written_whole
from hilbench.results.recording import NO_START_TIME, Recording
from hilbench.topology.signal_kinds import Signal
from hilbench.topology.signals import find_signal, unit_of


def write_mcap(recording: Recording, path: Path) -> None:
    """Write it; a channel that no part has is in the group `other`. Raises UnusableInputError."""
    began = recording.start_time or NO_START_TIME
    names = list(recording.channels)
    signals = [find_signal(name) or Signal(name, unit_of(name), "", "other") for name in names]
    with written_whole(path) as partial:
        sink = FoxgloveSink.file(partial, signals, recording.comment, began.timestamp())
        for row in np.column_stack([np.asarray(recording[name], np.float64) for name in names]).tolist():
            sink.take(row)
        sink.close()
