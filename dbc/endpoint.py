"""A node's end of the vehicle bus: counters on what it sends, judgement of what it receives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from canbus.frame import CAN_ID_MAX, Frame, FrameKind, ReceivedFrame
from dbc.codec import DECODED, Decoded, FrameFault, decode, decode_data, encode_bits
from dbc.messages import SPECS
from dbc.protection import COUNTER_MODULO, USABLE, AliveCheck, AliveState
from dbc.spec import MessageSpec

MessageT = TypeVar("MessageT")

SPEC_OF_NAME: Final[dict[str, MessageSpec]] = {spec.name: spec for spec in SPECS.values()}
"""Message specifications by their DBC name."""

ID_OF_NAME: Final = {name: spec.can_id for name, spec in SPEC_OF_NAME.items()}

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


class Subscription:
    """One identifier that a node listens to: how its frames are judged, and the newest message."""

    __slots__ = ("can_id", "check", "known", "newest", "timeout_ns")

    def __init__(self, spec: MessageSpec) -> None:
        self.can_id = spec.can_id
        self.timeout_ns = spec.timeout_ns
        self.check = AliveCheck()
        self.known = DECODED[spec.can_id]
        self.newest: Message | None = None

    def is_fresh(self, now_ns: int) -> bool:
        """Whether a message has come within the DBC's time-out."""
        newest = self.newest
        return newest is not None and now_ns - newest.arrival_ns <= self.timeout_ns


class Publication:
    """One message that a node sends: its next counter, and the content sent last."""

    __slots__ = ("bits", "counter", "message", "spec")

    def __init__(self, spec: MessageSpec) -> None:
        self.spec = spec
        self.counter = 0
        self.message: object = None
        self.bits = 0


class Endpoint:
    """One node's view of the bus.

    After `take`, `bad` holds the frames of ours that were ignored, `foreign` frames with an
    identifier of our own or of nobody's, and `handed_on` those that another reader of the node
    wants. These, and `is_bus_off`, are of this step alone; the newest messages and `counts` go on.

    Args:
        node: The DBC's name of the node.
        subscribed: Messages it listens to.
        hand_on: Identifiers of frames that are somebody else's to read: CANopen's.
        known: Identifiers that are in no DBC file and no stranger's: the drives'.
    """

    def __init__(
        self,
        node: str,
        subscribed: Iterable[str],
        hand_on: frozenset[int] = frozenset(),
        known: frozenset[int] = frozenset(),
    ) -> None:
        self.node = node
        self._hand_on = hand_on
        self._known = known
        self._own = sent_by(node)
        self._of_name = {name: Subscription(SPEC_OF_NAME[name]) for name in subscribed}
        self._of_id: list[Subscription | None] = [None] * (CAN_ID_MAX + 1)
        for wanted in self._of_name.values():
            self._of_id[wanted.can_id] = wanted
        self._sent = {SPECS[can_id].name: Publication(SPECS[can_id]) for can_id in self._own}
        self.bad: list[BadFrame] = []
        self.foreign: list[ReceivedFrame] = []
        self.handed_on: list[Frame] = []
        self.counts = dict.fromkeys(FrameFault, 0)
        self.lost = 0
        self.is_bus_off = False

    @property
    def acceptance(self) -> frozenset[int]:
        """Identifiers to let through: what is subscribed and, to notice strangers, our own."""
        return self._own.union(wanted.can_id for wanted in self._of_name.values())

    def take(self, received: Sequence[ReceivedFrame]) -> list[Message]:
        """Judges frames in order of arrival; answers the believable ones that are subscribed."""
        if self.bad or self.foreign or self.is_bus_off:
            self.bad, self.foreign, self.is_bus_off = [], [], False
        if self.handed_on:
            self.handed_on = []
        messages: list[Message] = []
        of_id = self._of_id
        for item in received:
            frame = item.frame
            can_id = frame.can_id
            wanted = of_id[can_id] if can_id <= CAN_ID_MAX else None
            if wanted is None or frame.kind is not _DATA:
                self._take_odd(item, wanted)
                continue
            decoded = wanted.known.get(frame.data)
            if decoded is None:
                decoded = decode_data(can_id, frame.data)
            if isinstance(decoded, Decoded):
                counter, check = decoded.counter, wanted.check
                if counter is None or (check.is_in_sequence and counter == check.expected):
                    message = Message(can_id, item.arrival_ns, decoded.message)  # as a rule
                    if counter is not None:
                        check.expected = (counter + 1) % COUNTER_MODULO
                        check.state = _OK
                    wanted.newest = message
                    messages.append(message)
                    continue
            believed = self._judge(item, wanted, decoded)
            if believed is not None:
                wanted.newest = believed
                messages.append(believed)
        return messages

    def _take_odd(self, item: ReceivedFrame, wanted: Subscription | None) -> None:
        """A frame of another kind, or with an identifier that is not subscribed."""
        frame = item.frame
        if frame.can_id in self._hand_on:
            self.handed_on.append(frame)
        if frame.kind is FrameKind.ERROR:
            self.is_bus_off |= bool(frame.can_id & ERROR_BUS_OFF)
        elif frame.kind is FrameKind.EXTENDED:
            self.foreign.append(item)  # the number may fit, the identifier does not
        elif wanted is not None:
            wanted.check.judge(None)
            self._ignore(item, FrameFault.KIND)
        elif frame.kind is _DATA and frame.can_id in self._known:
            return
        elif frame.can_id in self._own or frame.can_id not in SPECS:
            self.foreign.append(item)

    def _judge(
        self, item: ReceivedFrame, wanted: Subscription, decoded: Decoded | FrameFault
    ) -> Message | None:
        """What the fast path did not settle: faults, and counters out of sequence."""
        if isinstance(decoded, FrameFault):
            wanted.check.judge(None)
            self._ignore(item, decoded)
            return None
        state = wanted.check.judge(decoded.counter)
        if state is AliveState.REPEATED:
            self._ignore(item, FrameFault.REPEATED)
            return None
        if state not in USABLE and wanted.can_id not in STOPPING_IDS:
            if wanted.newest is not None:  # a first frame is nobody's fault
                self._ignore(item, FrameFault.SEQUENCE)
            return None
        self.lost += state is AliveState.LOST_ONE
        return Message(wanted.can_id, item.arrival_ns, decoded.message)

    def _ignore(self, item: ReceivedFrame, fault: FrameFault) -> None:
        self.counts[fault] += 1
        self.bad.append(BadFrame(item.arrival_ns, item.frame, fault))

    def frame(self, name: str, message: Any) -> Frame:
        """The next frame of one of our own messages, its counter advanced.

        A node that sends the very same object again saves the packing."""
        sent = self._sent[name]
        spec, counter = sent.spec, sent.counter
        if message is not sent.message:
            sent.bits = spec.pack(message)
            sent.message = message
        if spec.data_id is not None:
            sent.counter = (counter + 1) % COUNTER_MODULO
        return encode_bits(spec, sent.bits, counter)

    def subscription(self, name: str) -> Subscription:
        """What is known of one message; for those who ask every step."""
        return self._of_name[name]

    def are_fresh(self, names: Iterable[str], now_ns: int) -> bool:
        """Whether each of these messages has come within its time-out."""
        return False not in [self._of_name[name].is_fresh(now_ns) for name in names]

    def newest(self, name: str) -> Message | None:
        """The newest believable message, however old; None before the first."""
        return self._of_name[name].newest

    def get(self, name: str, kind: type[MessageT]) -> MessageT | None:
        """The newest believable content of a message, however old; None before the first."""
        message = self._of_name[name].newest
        if message is None:
            return None
        content = message.content
        assert isinstance(content, kind)
        return content

    def age_ns(self, name: str, now_ns: int) -> int | None:
        """Time since the newest believable frame of a message; None before the first."""
        message = self._of_name[name].newest
        return None if message is None else now_ns - message.arrival_ns

    def is_fresh(self, name: str, now_ns: int) -> bool:
        """Whether a message has come within the DBC's time-out."""
        return self._of_name[name].is_fresh(now_ns)
