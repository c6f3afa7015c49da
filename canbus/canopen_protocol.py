"""The parts of CANopen (CiA 301) a master needs, as pure functions and one non-blocking client."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final

from canbus.frame import Frame, FrameKind

NMT_ID: Final = 0x000
SDO_RESPONSE_ID: Final = 0x580
SDO_REQUEST_ID: Final = 0x600
HEARTBEAT_ID: Final = 0x700
NODE_ID_MAX: Final = 127
SDO_BYTES: Final = 8

ERROR_REGISTER: Final = 0x1001
EMCY_INHIBIT: Final = 0x1015
HEARTBEAT_TIME: Final = 0x1017
CONFIGURATION: Final = 0x2000
PARAMETERS: Final = 0x2100
DEVICE_OBJECTS: Final = (
    *(0x1000, ERROR_REGISTER, 0x1008, 0x100A, 0x1014, EMCY_INHIBIT, HEARTBEAT_TIME),
    *(0x1018, 0x1200),
)
"""Objects every device's EDS must have."""
REQUIRED_OBJECTS: Final = (*DEVICE_OBJECTS, CONFIGURATION, PARAMETERS)
"""Objects the EDS of a node of ours must have."""
COMMUNICATION_OBJECTS: Final = range(0x1002, 0x2000)
"""What a communication reset puts back; the error register tells what is, not what was set."""

ABORT_TIMEOUT: Final = 0x05040000
ABORT_COMMAND: Final = 0x05040001
ABORT_READ_ONLY: Final = 0x06010002
ABORT_NO_OBJECT: Final = 0x06020000
ABORT_LENGTH: Final = 0x06070010
ABORT_NO_SUBINDEX: Final = 0x06090011
ABORT_VALUE: Final = 0x06090030
ABORT_TOO_HIGH: Final = 0x06090031
ABORT_TOO_LOW: Final = 0x06090032
ABORT_STATE: Final = 0x08000022

INHIBIT_UNIT_NS: Final = 100_000
"""Unit of object 0x1015 (CiA 301)."""
HEARTBEAT_UNIT_NS: Final = 1_000_000
"""Unit of object 0x1017 (CiA 301)."""


_MULTIPLEXER: Final = struct.Struct("<BHB")
_ABORT: Final = struct.Struct("<BHBL")
_REQUEST_UPLOAD: Final = 0x40
_REQUEST_DOWNLOAD: Final = 0x23  # expedited, size given
_RESPONSE_UPLOAD: Final = 0x40
_RESPONSE_DOWNLOAD: Final = 0x60
_RESPONSE_ABORT: Final = 0x80
_EXPEDITED: Final = 0x02
_SIZE_GIVEN: Final = 0x01


class NmtState(IntEnum):
    """State of a node, as its heartbeat carries it (CiA 301, 7.2.8.3.2.2)."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Command specifier of an NMT frame (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class CanopenEventKind(Enum):
    """What the owner of a node is told."""

    NMT_COMMAND = "nmt_command"
    RESET_NODE = "reset_node"
    PARAMETER_WRITTEN = "parameter_written"


@dataclass(frozen=True, slots=True, kw_only=True)
class CanopenEvent:
    """One thing the owner must act on or report.

    Attributes:
        kind: NMT_COMMAND: start, stop or pre-operational obeyed. RESET_NODE: a reset obeyed; after
            `RESET_NODE` all parameters are back at their values of construction.
            PARAMETER_WRITTEN: a client wrote a parameter.
        command: the NMT command, for the first two.
        name: name of the parameter.
        value: its new value in SI.
    """

    kind: CanopenEventKind
    command: NmtCommand | None = None
    name: str = ""
    value: float = 0.0


def nmt_frame(command: NmtCommand, node_id: int) -> Frame:
    """The NMT frame that gives `command` to `node_id` (0: to all)."""
    assert 0 <= node_id <= NODE_ID_MAX, f"node id {node_id}"
    return Frame(NMT_ID, bytes((command, node_id)))


def heartbeat_state(frame: Frame) -> NmtState | None:
    """The state a heartbeat or boot-up reports; None when `frame` is none or is malformed."""
    if not HEARTBEAT_ID < frame.can_id <= HEARTBEAT_ID + NODE_ID_MAX:
        return None
    if frame.kind is not FrameKind.DATA or len(frame.data) != 1:
        return None
    try:
        return NmtState(frame.data[0])
    except ValueError:
        return None


@dataclass(frozen=True, slots=True)
class SdoAbort:
    """An SDO request that failed: the server's abort code (CiA 301, table 22), or a time-out."""

    code: int


SdoKey = tuple[int, int, int]
"""Node id, index, sub-index."""


@dataclass(slots=True)
class _Pending:
    """The request a node has not answered yet."""

    key: SdoKey
    data: bytes
    written: int | None
    deadline_ns: int
    attempts_left: int


class SdoClient:
    """Reads and writes objects of up to four bytes, one at a time per node, never blocking.

    An answer lands in `results`: the value as an unsigned little-endian number (of a write: what
    was written), or an `SdoAbort`.
    A request that stays unanswered for `timeout_ns` is sent again, `attempts` times in all, then
    reported as `SdoAbort(0x05040000)`. Objects longer than four bytes are aborted towards the
    server and reported as `SdoAbort(0x05040001)`: this client has no segmented transfer.

    Args:
        timeout_ns: time for an answer.
        attempts: how often a request is sent before it counts as failed.

    Attributes:
        results: answers so far. Asking again removes the old one.
        bad_frames: malformed answers of nodes that were asked (wrong kind, length or command).
    """

    def __init__(self, *, timeout_ns: int = 200_000_000, attempts: int = 3) -> None:
        if timeout_ns <= 0 or attempts < 1:
            raise ValueError(
                f"timeout {timeout_ns} ns must be above 0, attempts {attempts} at least 1"
            )
        self.results: dict[SdoKey, int | SdoAbort] = {}
        self.bad_frames = 0
        self._timeout_ns = timeout_ns
        self._attempts = attempts
        self._pending: dict[int, _Pending] = {}
        self._queues: dict[int, deque[_Pending]] = {}

    def request(self, node_id: int, index: int, subindex: int) -> None:
        """Ask `node_id` for one object; a question already under way is not asked twice."""
        data = _MULTIPLEXER.pack(_REQUEST_UPLOAD, index, subindex) + bytes(4)
        self._add(_Pending((node_id, index, subindex), data, None, 0, self._attempts))

    def write(self, node_id: int, index: int, subindex: int, value: int, byte_count: int) -> None:
        """Write an object of 1 to 4 bytes, after all that was asked of the node before."""
        assert 1 <= byte_count <= 4, f"{byte_count} bytes"
        command = _REQUEST_DOWNLOAD | 4 - byte_count << 2
        body = value.to_bytes(byte_count, "little", signed=value < 0).ljust(4, b"\0")
        data = _MULTIPLEXER.pack(command, index, subindex) + body
        self._add(_Pending((node_id, index, subindex), data, value, 0, self._attempts))

    def _add(self, wanted: _Pending) -> None:
        node_id, index, subindex = wanted.key
        assert 1 <= node_id <= NODE_ID_MAX, f"node id {node_id}"
        assert 0 <= index <= 0xFFFF and 0 <= subindex <= 0xFF, f"{index:#x}:{subindex:#x}"
        self.results.pop(wanted.key, None)
        queue = self._queues.setdefault(node_id, deque())
        pending = self._pending.get(node_id)
        under_way = [other.data for other in queue] + ([pending.data] if pending else [])
        if wanted.data not in under_way:
            queue.append(wanted)

    @property
    def busy(self) -> bool:
        """Whether any question is still open."""
        return bool(self._pending) or any(self._queues.values())

    def step(self, now_ns: int, received: Iterable[Frame] = ()) -> list[Frame]:
        """Take in answers and return the frames to send (requests, repeats, aborts)."""
        frames: list[Frame] = []
        if self._pending:
            for frame in received:
                pending = self._pending.get(frame.can_id - SDO_RESPONSE_ID)
                if pending is not None:
                    self._answer(pending, frame, frames)
        for pending in list(self._pending.values()):
            if now_ns >= pending.deadline_ns:
                self._timed_out(pending, now_ns, frames)
        for node_id, queue in self._queues.items():
            if queue and node_id not in self._pending:
                pending = self._pending[node_id] = queue.popleft()
                self._ask(pending, now_ns, frames)
        return frames

    def _ask(self, pending: _Pending, now_ns: int, frames: list[Frame]) -> None:
        pending.deadline_ns = now_ns + self._timeout_ns
        pending.attempts_left -= 1
        frames.append(Frame(SDO_REQUEST_ID + pending.key[0], pending.data))

    def _timed_out(self, pending: _Pending, now_ns: int, frames: list[Frame]) -> None:
        if pending.attempts_left:
            self._ask(pending, now_ns, frames)
        else:
            self._finish(pending, SdoAbort(ABORT_TIMEOUT))

    def _answer(self, pending: _Pending, frame: Frame, frames: list[Frame]) -> None:
        """Take one frame with the identifier of the node that was asked."""
        if frame.kind is not FrameKind.DATA or len(frame.data) != SDO_BYTES:
            self.bad_frames += 1
            return
        command, index, subindex = _MULTIPLEXER.unpack_from(frame.data)
        if (index, subindex) != pending.key[1:]:
            return  # a late answer to an earlier question, or to another client
        if command == _RESPONSE_ABORT:
            self._finish(pending, SdoAbort(_ABORT.unpack(frame.data)[3]))
        elif pending.written is not None:
            if command == _RESPONSE_DOWNLOAD:
                self._finish(pending, pending.written)
            else:
                self.bad_frames += 1
        elif command & 0xE0 != _RESPONSE_UPLOAD:
            self.bad_frames += 1
        elif command & _EXPEDITED:
            size = 4 - (command >> 2 & 3) if command & _SIZE_GIVEN else 4
            self._finish(pending, int.from_bytes(frame.data[4 : 4 + size], "little"))
        else:
            abort = _ABORT.pack(_RESPONSE_ABORT, index, subindex, ABORT_COMMAND)
            frames.append(Frame(SDO_REQUEST_ID + pending.key[0], abort))
            self._finish(pending, SdoAbort(ABORT_COMMAND))

    def _finish(self, pending: _Pending, result: int | SdoAbort) -> None:
        self.results[pending.key] = result
        del self._pending[pending.key[0]]
