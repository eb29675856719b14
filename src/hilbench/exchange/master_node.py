"""The bench's own node on the bus: others read and write its objects by SDO."""

from __future__ import annotations

from collections.abc import Iterable

from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import SDO_REQUEST
from hilbench.canopen.object_store import ObjectStore
from hilbench.canopen.sdo_server import DeviceSdoServer


class MasterNode:
    """Serves the objects of a store. A request of a cycle is answered with the next, so that it is in the trace."""

    def __init__(self, node_id: int, objects: ObjectStore) -> None:
        self._request_id = SDO_REQUEST + node_id
        self._answers: list[Frame] = []
        self._server = DeviceSdoServer(
            node_id, objects, lambda cob_id, data: self._answers.append(Frame(cob_id, bytes(data)))
        )

    def handle(self, frames: Iterable[Frame]) -> None:
        """Serve SDO requests among the frames received in a cycle."""
        for cob_id, data, _ in frames:
            if cob_id == self._request_id:
                self._server.handle(data)

    @property
    def has_answers(self) -> bool:
        """True if SDO answers wait for the next cycle."""
        return bool(self._answers)

    def answers(self) -> list[Frame]:
        """Take the SDO answers to send with the next cycle."""
        answers, self._answers = self._answers, []
        return answers
