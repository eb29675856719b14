"""The pictures by kind of machine."""

from __future__ import annotations

from hilbench.apps.report.machines import servo_axis, web_line
from hilbench.apps.report.machines.picture import MachinePictures
from hilbench.results.recording import Recording
from hilbench.topology.signals import kind_of, shape_of


def pictures_of(recording: Recording) -> MachinePictures:
    """Those of the machine whose signals are recorded."""
    if kind_of(recording.channels) == "servo_axis":
        return servo_axis.PICTURES
    return web_line.pictures_of(shape_of(recording.channels))
