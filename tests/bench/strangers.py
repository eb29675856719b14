"""Stations that are none of the bench's, on the bus of a bench that runs in one process: each time the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import pytest

from hilbench.bench.lifecycle import in_process
from hilbench.bench.lifecycle.in_process import InProcess
from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryLink
from hilbench.topology.config import BenchConfig

#: Of a run in which strangers have their say.
STEPS = [{"ramp": {"path": "line_speed_m_s", "to": 0.5, "duration_s": 0.2}}, {"hold": {"until_s": 0.6}}]
#: What a stranger sends when it has heard the SYNC of this number (from 1), beside the frames it has heard since.
Plan = Callable[[int, Sequence[Frame]], Sequence[Frame]]


class Stranger:
    """A station that acts on SYNC, as the devices of the bench do."""

    def __init__(self, link: MemoryLink, plan: Plan) -> None:
        self._link = link
        self._plan = plan
        self._syncs = 0

    def boot(self) -> None:
        """It says nothing of itself."""

    def serve(self, timeout_s: float) -> None:
        """Answer the SYNCs that have come."""
        frames = self._link.receive(timeout_s)
        for frame in frames:
            if frame.can_id == 0x080:
                self._syncs += 1
                answers = self._plan(self._syncs, frames)
                if answers:
                    self._link.send(answers)


@contextmanager
def on_the_bus(*plans: Plan) -> Iterator[None]:
    """Strangers join every bench that is started in this process meanwhile."""

    class Infested(InProcess):
        def __init__(self, config: BenchConfig) -> None:
            super().__init__(config)
            self._hosts += [Stranger(self.bus.open_link(), plan) for plan in plans]  # type: ignore[list-item]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(in_process, "InProcess", Infested)
        yield


def from_sync(first: int, *frames: Frame, until: int = 1 << 30) -> Plan:
    """These frames behind each SYNC from `first` to before `until`."""
    return lambda sync, received: frames if first <= sync < until else ()
