"""The pictures by kind of machine."""

from __future__ import annotations

from typing import Final

from hilbench.report.machines import servo_axis, web_line
from hilbench.report.machines.picture import MachinePictures
from hilbench.results.recording import Recording
from hilbench.topology.signals import kind_of

_PICTURES: Final = {"web_line": web_line.PICTURES, "servo_axis": servo_axis.PICTURES}
#: Names of the pictures that are shown around each step, too.
ZOOMED: Final = frozenset(each.name for of in _PICTURES.values() for each in of.pictures if each.zoomed)


def pictures_of(recording: Recording) -> MachinePictures:
    """Those of the machine whose signals are recorded."""
    return _PICTURES[kind_of(recording.channels)]
