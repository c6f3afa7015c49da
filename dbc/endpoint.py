"""A node's end of the vehicle bus: counters on what it sends, judgement of what it receives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from canbus.frame import Frame, FrameKind, ReceivedFrame
from dbc.codec import DECODED, Decoded, FrameFault, decode, decode_data, encode
from dbc.messages import SPECS
from dbc.protection import COUNTER_MODULO, USABLE, AliveCheck, AliveState
from dbc.spec import MessageSpec

MessageT = TypeVar("MessageT")

SPEC_OF_NAME: Final[dict[str, MessageSpec]] = {spec.name: spec for spec in SPECS.values()}
"""Message specifications by their DBC name."""

ID_OF_NAME: Final = {name: spec.can_id for name, spec in SPEC_OF_NAME.items()}
TIMEOUT_NS_OF_NAME: Final = {name: spec.timeout_ns for name, spec in SPEC_OF_NAME.items()}

FAILSAFE_ID: Final = SPEC_OF_NAME["FAILSAFE"].can_id

ERROR_BUS_OFF: Final = 0x40
"""Bit of an error frame's identifier: the controller went bus-off (Linux can/error.h)."""

STOPPING_IDS: Final = frozenset(
    spec.can_id for spec in SPECS.values() if spec.name.endswith("EMERGENCY_BRAKE")
)
"""Frames that can only stop the car: believed at once, without waiting for a second in sequence."""

_DATA: Final = FrameKind.DATA
_OK: Final = AliveState.OK


@dataclass(slots=True, init=False, unsafe_hash=True)
class Message:
    """A message worth believing, with its arrival time on the node's clock."""

    can_id: Final[int]
    arrival_ns: Final[int]
    content: Final[Any]

    def __init__(self, can_id: int, arrival_ns: int, content: Any) -> None:
        self.can_id = can_id
        self.arrival_ns = arrival_ns
        self.content = content


@dataclass(frozen=True, slots=True)
class BadFrame:
    """A frame of ours that was ignored."""

    arrival_ns: int
    frame: Frame
    fault: FrameFault


def sent_by(node: str) -> frozenset[int]:
    """Identifiers that only this node may send."""
    return frozenset(spec.can_id for spec in SPECS.values() if spec.sender == node)


def is_forged(frame: Frame) -> bool:
    """Whether a stranger's frame would be believed as one of ours: protected, and intact.

    One that is not intact harms nobody: all receivers ignore it (ER0).
    """
    decoded = decode(frame)
    return isinstance(decoded, Decoded) and decoded.counter is not None


class Endpoint:
    """One node's view of the bus.

    After `take`, `latest` holds the newest believable message per identifier, `bad` the frames of
    ours that were ignored, `foreign` frames with an identifier of our own or of nobody's. The last
    two, and `is_bus_off`, are of this step alone; `counts` goes on.
    """

    def __init__(self, node: str, subscribed: Iterable[str]) -> None:
        self.node = node
        self._own = sent_by(node)
        self._checks = {SPEC_OF_NAME[name].can_id: AliveCheck() for name in subscribed}
        self._counters = dict.fromkeys(self._own, 0)
        self.latest: dict[int, Message] = {}
        self.bad: list[BadFrame] = []
        self.foreign: list[ReceivedFrame] = []
        self.counts = dict.fromkeys(FrameFault, 0)
        self.lost = 0
        self.is_bus_off = False

    @property
    def acceptance(self) -> frozenset[int]:
        """Identifiers to let through: what is subscribed and, to notice strangers, our own."""
        return self._own.union(self._checks)

    def take(self, received: Sequence[ReceivedFrame]) -> list[Message]:
        """Judges frames in order of arrival; answers the believable ones that are subscribed."""
        if self.bad or self.foreign or self.is_bus_off:
            self.bad, self.foreign, self.is_bus_off = [], [], False
        messages: list[Message] = []
        checks, latest = self._checks, self.latest
        for item in received:
            frame = item.frame
            can_id = frame.can_id
            check = checks.get(can_id)
            if check is None or frame.kind is not _DATA:
                self._take_odd(item, check)
                continue
            decoded = DECODED[can_id].get(frame.data)
            if decoded is None:
                decoded = decode_data(can_id, frame.data)
            if isinstance(decoded, Decoded):
                counter = decoded.counter
                if counter is None or (check.is_in_sequence and counter == check.expected):
                    message = Message(can_id, item.arrival_ns, decoded.message)  # as a rule
                    if counter is not None:
                        check.expected = (counter + 1) % COUNTER_MODULO
                        check.state = _OK
                    latest[can_id] = message
                    messages.append(message)
                    continue
            believed = self._judge(item, check, decoded)
            if believed is not None:
                latest[can_id] = believed
                messages.append(believed)
        return messages

    def _take_odd(self, item: ReceivedFrame, check: AliveCheck | None) -> None:
        """A frame of another kind, or with an identifier that is not subscribed."""
        frame = item.frame
        if frame.kind is FrameKind.ERROR:
            self.is_bus_off |= bool(frame.can_id & ERROR_BUS_OFF)
        elif frame.kind is FrameKind.EXTENDED:
            self.foreign.append(item)  # the number may fit, the identifier does not
        elif check is not None:
            check.judge(None)
            self._ignore(item, FrameFault.KIND)
        elif frame.can_id in self._own or frame.can_id not in SPECS:
            self.foreign.append(item)

    def _judge(
        self, item: ReceivedFrame, check: AliveCheck, decoded: Decoded | FrameFault
    ) -> Message | None:
        """What the fast path did not settle: faults, and counters out of sequence."""
        if isinstance(decoded, FrameFault):
            check.judge(None)
            self._ignore(item, decoded)
            return None
        can_id = item.frame.can_id
        state = check.judge(decoded.counter)
        if state is AliveState.REPEATED:
            self._ignore(item, FrameFault.REPEATED)
            return None
        if state not in USABLE and can_id not in STOPPING_IDS:
            if can_id in self.latest:  # a first frame is nobody's fault
                self._ignore(item, FrameFault.SEQUENCE)
            return None
        self.lost += state is AliveState.LOST_ONE
        return Message(can_id, item.arrival_ns, decoded.message)

    def _ignore(self, item: ReceivedFrame, fault: FrameFault) -> None:
        self.counts[fault] += 1
        self.bad.append(BadFrame(item.arrival_ns, item.frame, fault))

    def frame(self, name: str, message: Any) -> Frame:
        """The next frame of one of our own messages, its counter advanced."""
        spec = SPEC_OF_NAME[name]
        counter = self._counters[spec.can_id]
        if spec.data_id is not None:
            self._counters[spec.can_id] = (counter + 1) % COUNTER_MODULO
        return encode(spec, message, counter)

    def newest(self, name: str) -> Message | None:
        """The newest believable message, however old; None before the first."""
        return self.latest.get(ID_OF_NAME[name])

    def get(self, name: str, kind: type[MessageT]) -> MessageT | None:
        """The newest believable content of a message, however old; None before the first."""
        message = self.latest.get(ID_OF_NAME[name])
        if message is None:
            return None
        content = message.content
        assert isinstance(content, kind)
        return content

    def age_ns(self, name: str, now_ns: int) -> int | None:
        """Time since the newest believable frame of a message; None before the first."""
        message = self.latest.get(ID_OF_NAME[name])
        return None if message is None else now_ns - message.arrival_ns

    def is_fresh(self, name: str, now_ns: int) -> bool:
        """Whether a message has come within the DBC's time-out."""
        message = self.latest.get(ID_OF_NAME[name])
        return message is not None and now_ns - message.arrival_ns <= TIMEOUT_NS_OF_NAME[name]
