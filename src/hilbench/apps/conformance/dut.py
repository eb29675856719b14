"""The device under test: requests with what is expected of their answers, and everything as it was afterwards.

An expectation is written as the frame's data in hexadecimal digits with `?` for any digit; blanks don't count.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Final

from hilbench.apps.conformance.actions import Key
from hilbench.apps.conformance.description import Description, Pdo
from hilbench.apps.conformance.record import CaseEndedError, NotAllowedError, NotApplicableError, Step
from hilbench.apps.conformance.wire import Wire
from hilbench.can.frame import REMOTE_FLAG, Frame
from hilbench.canopen.identifiers import (
    COB_ID,
    EMERGENCY,
    HEARTBEAT,
    LAST_NODE,
    NMT,
    NODE_ID,
    SDO_ANSWER,
    SDO_REQUEST,
    SYNC,
    NmtCommand,
    NmtState,
    node_of,
)
from hilbench.canopen.sdo_client import Answer, Refusal, SdoAbortedError, SdoCommunicationError, Transfers

#: Heartbeat period while a case looks at NMT states, and how long it waits for one.
_HEARTBEAT_MS: Final = 100
_HEARTBEAT_S: Final = 0.35
_AFTER_BOOT_S: Final = 0.05
_ANSWER_S: Final = 1.0
_EMPTY: Final = "nothing"
_SDO_BYTES: Final = 8
#: Command specifiers of requests that name an object, and whose answers do: download and upload.
_NAMES_OBJECT: Final = (1, 2)
_SYNC_PAUSE_S: Final = 0.02


class DeviceUnderTest:
    """A node on a wire. Expectations are recorded in `steps`; those that must hold to go on end the case.

    `motion`, `store`: permissions beyond communication; `boot_s`: longest time from a reset to the boot-up message.
    """

    #: PDO of the present case, once it has chosen one (`pdo_cases.transmit_pdo`, `receive_pdo`).
    pdo: Pdo

    def __init__(
        self,
        wire: Wire,
        node_id: int,
        description: Description,
        *,
        motion: bool = False,
        store: bool = False,
        boot_s: float = 10.0,
    ) -> None:
        self.wire = wire
        self.node_id = node_id
        self.eds = description
        self.motion, self.store = motion, store
        self._boot_s = boot_s
        self._answer_id = SDO_ANSWER + node_id
        self.steps: list[Step] = []
        self.notes: list[str] = []
        #: Objects that were written, and whether all may be others since a reset.
        self.touched: set[tuple[int, int]] = set()
        self.was_reset = False
        #: Values of before, of a case that compares them with those of later.
        self.remembered: dict[tuple[int, int], int] = {}
        self._sent: list[str] = []
        self._received: list[Frame] = []

    # -- what a case needs -----------------------------------------------------------------------------------

    def needs_motion(self, why: str) -> None:
        """Raises NotAllowedError when nothing may move."""
        if not self.motion:
            raise NotAllowedError(f"{why}: --allow-motion")

    def needs_store(self) -> None:
        """Raises NotAllowedError when nothing may be stored."""
        if not self.store:
            raise NotAllowedError("writes the device's memory (1010h, 1011h): --allow-store")

    def needs(self, keys: Sequence[Key]) -> None:
        """Raises NotApplicableError when the EDS file lacks one of them."""
        for index, sub in keys:
            if not self.eds.has(index, sub):
                raise NotApplicableError(f"{self.name(index, sub)} is not in the EDS file")

    def needs_to_write(self, keys: Sequence[Key]) -> None:
        """Raises NotApplicableError when the EDS file lacks one of them, or has it read-only."""
        self.needs(keys)
        for index, sub in keys:
            if not self.eds.can_write(index, sub):
                raise NotApplicableError(
                    f"{self.name(index, sub)} is {self.eds.entry(index, sub).access} in the EDS file"
                )

    def name(self, index: int, sub: int) -> str:
        """An object as messages call it."""
        return f"{self.eds.own(index):04X}h:{sub}"

    # -- frames ----------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """A case begins."""
        self.steps, self.notes, self._sent, self._received = [], [], [], []
        self.wire.listen(0.0)

    def send(self, can_id: int, data: bytes = b"") -> None:
        """A frame onto the bus."""
        remote = " remote" if can_id & REMOTE_FLAG else ""
        self._sent.append(f"{can_id & COB_ID:03X}{remote} {data.hex(' ')}".strip())
        self.wire.send(can_id, data)

    def receive(self, duration_s: float) -> list[Frame]:
        """Frames since the last call, and in this time; answers to SDO requests left out."""
        found = [*self._received, *self.wire.listen(duration_s)]
        self._received = []
        return [received for received in found if received.can_id != self._answer_id]

    def receive_until(self, can_id: int, then_s: float) -> list[Frame]:
        """Frames up to one that is awaited as long as an answer, and for a time behind it."""
        if not any(received.can_id == can_id for received in self._received):
            self._received += self.wire.listen(_ANSWER_S, lambda received: received.can_id == can_id)
        return self.receive(then_s)

    def receive_id(self, can_id: int, duration_s: float) -> list[Frame]:
        """Frames of one identifier since the last call, and in this time."""
        return [received for received in self.receive(duration_s) if received.can_id == can_id]

    def wait(self, duration_s: float) -> None:
        """Time passes; what comes meanwhile is kept for the next look."""
        self._received += self.wire.listen(duration_s)

    def forget(self) -> None:
        """Discard the frames received up to now."""
        self.receive(0.0)

    def nmt(self, command: NmtCommand, node_id: int | None = None) -> None:
        """An NMT command, by default to the device."""
        self.send(NMT, bytes((command, self.node_id if node_id is None else node_id)))
        self.receive(_SYNC_PAUSE_S)

    def sync(self, data: bytes = b"") -> list[Frame]:
        """A SYNC, and what it brings."""
        self.send(self.sync_id, data)
        return self.receive(_SYNC_PAUSE_S)

    def sync_brings(self, can_id: int, data: bytes = b"") -> bool:
        """True if a SYNC brings a frame of an identifier."""
        return any(received.can_id == can_id for received in self.sync(data))

    @property
    def sync_id(self) -> int:
        """1005h of the device, or the default."""
        known = self.number(0x1005) if self.eds.has(0x1005) else None
        return SYNC if known is None else known & COB_ID

    @property
    def emergency_id(self) -> int:
        """1014h of the device, or the default."""
        known = self.number(0x1014) if self.eds.has(0x1014) else None
        return EMERGENCY + self.node_id if known is None else known & COB_ID

    # -- expectations ----------------------------------------------------------------------------------------

    def check(self, what: str, expected: str, seen: str, ok: bool) -> bool:
        """Record an expectation; what was sent since the last one belongs to it."""
        self.steps.append(Step(what, "; ".join(self._sent[-4:]), expected, seen, ok))
        self._sent = []
        return ok

    def must(self, ok: bool) -> None:
        """Ends the case when what it goes on from has not happened."""
        if not ok:
            raise CaseEndedError

    def frames(self, what: str, found: Sequence[Frame], can_id: int, *expected: str) -> bool:
        """Expect exactly these data, in this order, of an identifier."""
        seen = [received.data.hex() for received in found if received.can_id == can_id]
        ok = len(seen) == len(expected) and all(map(matches, expected, seen))
        return self.check(what, _frames_text(can_id, expected), _frames_text(can_id, seen), ok)

    # -- SDO -------------------------------------------------------------------------------------------------

    def exchange(self, request: bytes) -> bytes | None:
        """The answer to an SDO request; None: there is none. An answer that is late is not taken for the next one's."""
        names_object = request[0] >> 5 in _NAMES_OBJECT and len(request) == _SDO_BYTES
        self._answers(0.0)

        def answers(received: Frame) -> bool:
            return received.can_id == self._answer_id and (not names_object or received.data[1:4] == request[1:4])

        self.send(SDO_REQUEST + self.node_id, request)
        replies = self._answers(_ANSWER_S, answers)
        return replies[-1] if replies else None

    def _answers(self, duration_s: float, until: Callable[[Frame], bool] | None = None) -> list[bytes]:
        """Answers to SDO requests in this time; other frames are kept for the next look."""
        found = self.wire.listen(duration_s, until)
        self._received += [received for received in found if received.can_id != self._answer_id]
        return [received.data for received in found if received.can_id == self._answer_id]

    def ask(self, what: str, request: str, *expected: str) -> bytes:
        """A request whose answer is one of the expected ones; what was answered, empty when there is none."""
        answer = self.exchange(bytes.fromhex(request)) or b""
        self._expect_answer(what, answer, expected)
        return answer

    def _expect_answer(self, what: str, answer: bytes, expected: Collection[str]) -> bool:
        ok = any(matches(pattern, answer.hex()) for pattern in expected)
        texts = " or ".join(spaced(pattern) for pattern in expected)
        return self.check(
            what, f"{self._answer_id:03X} {texts}", f"{self._answer_id:03X} {answer.hex(' ')}" if answer else _EMPTY, ok
        )

    def segments(self, count: int) -> list[bytes]:
        """Frames of a block that come without a request each."""
        found: list[bytes] = []
        while len(found) < count:
            answers = self._answers(_ANSWER_S, lambda received: received.can_id == self._answer_id)
            if not answers:
                break
            found += answers
        return found

    def peek(self, index: int, sub: int) -> Answer:
        """A value, without an expectation: for what a case needs to know."""
        return self._transferred(lambda client: client.open(self.eds.own(index), sub, buffering=0).read())

    def _transferred(self, transfer: Callable[[Transfers], bytes | None]) -> Answer:
        kept, self._sent = self._sent, []
        try:
            return transfer(Transfers(self.exchange)) or b""
        except SdoAbortedError as error:
            return Refusal(error.code)
        except SdoCommunicationError:
            return None
        finally:
            self._sent = kept

    def number(self, index: int, sub: int = 0) -> int | None:
        """A number (unsigned), without an expectation; None: it is not there."""
        answer = self.peek(index, sub)
        return int.from_bytes(answer, "little") if isinstance(answer, bytes) else None

    def value(self, index: int, sub: int = 0) -> int:
        """A number that the case can't do without (unsigned)."""
        answer = self.peek(index, sub)
        if not isinstance(answer, bytes):
            self.check(f"read {self.name(index, sub)}", "a value", answer_text(answer), False)
            raise CaseEndedError
        return int.from_bytes(answer, "little")

    def signed(self, index: int, sub: int = 0) -> int:
        """Value decoded as its type in the EDS file."""
        kind = self.eds.entry(index, sub).kind
        return int(kind.decode(self.value(index, sub).to_bytes(kind.width or 4, "little")))

    def reads(self, what: str, index: int, sub: int, expected: int) -> bool:
        """Expect a number (unsigned) in an object."""
        answer = self.peek(index, sub)
        self._sent.append(f"read {self.name(index, sub)}")
        ok = isinstance(answer, bytes) and int.from_bytes(answer, "little") == expected
        return self.check(what, f"{expected:X}h", answer_text(answer), ok)

    def try_to_write(self, index: int, sub: int, data: bytes) -> Answer:
        """Write, without an expectation: b"" when it was taken."""
        self.touched.add((self.eds.own(index), sub))
        return self._transferred(lambda client: client.download(self.eds.own(index), sub, data))

    def offer(self, index: int, value: int) -> Answer:
        """Write a number, without an expectation: b"" when it was taken."""
        return self.try_to_write(index, 0, self.data_of(index, 0, value))

    def data_of(self, index: int, sub: int, value: int) -> bytes:
        """SDO data of a number, in the length of the EDS file."""
        width = (self.eds.entry(index, sub).kind.width or 4) if self.eds.has(index, sub) else 4
        return (value & ((1 << 8 * width) - 1)).to_bytes(width, "little")

    def write(self, index: int, sub: int, value: int) -> None:
        """Write a number; a refusal ends the case."""
        self.must(self.takes(f"write {value:X}h to {self.name(index, sub)}", index, sub, value))

    def takes(self, what: str, index: int, sub: int, value: int) -> bool:
        """Expect that a number is taken."""
        expected = f"60{_mux(self.eds.own(index), sub)}????????"
        return self._expect_write(what, index, sub, self.data_of(index, sub, value), [expected])

    def refuses(self, what: str, index: int, sub: int, data: bytes, *codes: int) -> bool:
        """Expect that data are refused with one of these abort codes."""
        return self._expect_write(what, index, sub, data, [aborted(self.eds.own(index), sub, code) for code in codes])

    def _expect_write(self, what: str, index: int, sub: int, data: bytes, expected: Collection[str]) -> bool:
        """Expect one of these answers to the request that writes up to four bytes at once."""
        own = self.eds.own(index)
        self.touched.add((own, sub))
        answer = self.exchange(multiplexed(0x23 | (4 - len(data)) << 2, own, sub, data)) or b""
        return self._expect_answer(what, answer, expected)

    def configure(self, index: int, sub: int, value: int, what: str) -> None:
        """Write what not every device has to take. Raises NotApplicableError when it refuses."""
        answer = self.try_to_write(index, sub, self.data_of(index, sub, value))
        if isinstance(answer, Refusal):
            raise NotApplicableError(f"{what}: {self.name(index, sub)} = {value:X}h is refused, {answer}")
        if answer is None:
            self.must(self.check(what, "an answer", _EMPTY, False))

    # -- NMT -------------------------------------------------------------------------------------------------

    def reset(self, command: NmtCommand = NmtCommand.RESET_NODE) -> None:
        """Reset and expect the boot-up message: one byte, 0. It is on as soon as its server answers."""
        self.was_reset = True
        can_id = HEARTBEAT + self.node_id
        self.forget()
        self.send(NMT, command.to(self.node_id))
        # A heartbeat may be under way when the command comes.
        before = {state.heartbeat for state in NmtState if state is not NmtState.INITIALISING}

        def boots(received: Frame) -> bool:
            return received.can_id == can_id and received.data not in before

        found = self.wire.listen(self._boot_s, boots)
        self.must(self.frames("boot-up message", list(filter(boots, found)) or found, can_id, "00"))
        self.wire.listen(_AFTER_BOOT_S)

    def produce_heartbeats(self, period_ms: int = _HEARTBEAT_MS) -> None:
        """Set 1017h. Raises NotApplicableError for a device without."""
        self.needs_to_write([(0x1017, 0)])
        self.write(0x1017, 0, period_ms)

    def shows(self, state: NmtState) -> bool:
        """Expect an NMT state in the next heartbeat."""
        can_id = HEARTBEAT + self.node_id
        self.forget()
        found = self.wire.listen(_HEARTBEAT_S, lambda received: received.can_id == can_id)
        beats = [received for received in found if received.can_id == can_id]
        return self.frames(f"heartbeat in {state.name.replace('_', '-')}", beats, can_id, state.heartbeat.hex())

    def strangers(self, duration_s: float) -> list[int]:
        """Node ids that are not received in a time, and that no heartbeat consumer entry watches."""
        known = {node_of(received.can_id, HEARTBEAT) for received in self.receive(duration_s)} | {self.node_id}
        known |= {self.value(*entry.key) >> 16 & NODE_ID for entry in self.eds.entries(0x1016, 0x1016) if entry.sub}
        return [node for node in range(LAST_NODE, 0, -1) if node not in known]


def matches(pattern: str, seen: str) -> bool:
    """True if hexadecimal digits match the expected ones."""
    wanted = pattern.replace(" ", "").lower()
    return len(wanted) == len(seen) and all(a in ("?", b) for a, b in zip(wanted, seen.lower(), strict=True))


def spaced(digits: str) -> str:
    """Hexadecimal digits byte by byte."""
    packed = digits.replace(" ", "")
    return " ".join(packed[at : at + 2] for at in range(0, len(packed), 2))


def multiplexed(head: int, index: int, sub: int, data: bytes = b"") -> bytes:
    """An SDO frame: command, index, sub-index, four bytes."""
    return bytes((head, index & 0xFF, index >> 8, sub)) + data.ljust(4, b"\0")


def aborted(index: int, sub: int, code: int) -> str:
    """The abort of a transfer."""
    return f"80{_mux(index, sub)}{code.to_bytes(4, 'little').hex()}"


def _mux(index: int, sub: int) -> str:
    return bytes((index & 0xFF, index >> 8, sub)).hex()


def answer_text(answer: Answer) -> str:
    """The answer to a request to read, for a person."""
    if isinstance(answer, bytes):
        return answer.hex(" ")
    return _EMPTY if answer is None else str(answer)


def taken_text(answer: Answer) -> str:
    """The answer to a request to write."""
    return "taken" if isinstance(answer, bytes) else answer_text(answer)


def _frames_text(can_id: int, frames: Sequence[str]) -> str:
    if not frames:
        return f"no {can_id & COB_ID:03X}"
    shown = [f"{can_id & COB_ID:03X} {spaced(data)}".strip() for data in frames[:6]]
    return "; ".join(shown) + (f" … ({len(frames)} frames)" if len(frames) > 6 else "")
