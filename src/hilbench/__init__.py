"""hilbench: a hardware-in-the-loop test bench over CAN/CANopen with a synchronized twin.

For scripts, tests and notebooks: `Bench`, `Recording`, `Result`, `SimulatedDrive`, `read_recording`. They are imported
on first use, so that ``import hilbench`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hilbench.apps.devices.drive import SimulatedDrive
    from hilbench.apps.scripts.bench import Bench
    from hilbench.results.recording import Recording, read_recording
    from hilbench.results.result import Result

__all__ = ["Bench", "Recording", "Result", "SimulatedDrive", "read_recording"]

_PLACES = {
    "Bench": "hilbench.apps.scripts.bench",
    "Recording": "hilbench.results.recording",
    "Result": "hilbench.results.result",
    "SimulatedDrive": "hilbench.apps.devices.drive",
    "read_recording": "hilbench.results.recording",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'hilbench' has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), name)
