"""The pictures by kind of machine."""

from __future__ import annotations

from hilbench.apps.report.machines.picture import MachinePictures
from hilbench.machine_kinds import machine_part
from hilbench.results.recording import Recording
from hilbench.topology.signals import kind_of, shape_of


def pictures_of(recording: Recording) -> MachinePictures:
    """Those of the machine whose signals are recorded."""
    pictures: MachinePictures = machine_part(kind_of(recording.channels), "pictures")(shape_of(recording.channels))
    return pictures
