"""One node's CAN controller: what waits to be sent, and how far it is trusted to send.

Fault confinement by ISO 11898-1: errors raise two counters, success lowers them, and a controller
that raises too many loses first its right to disturb others, then its place on the bus.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Final

from canbus.frame import Frame

ERROR_PASSIVE_FROM: Final = 128
"""Either counter at this: the controller's error flags are recessive and disturb nobody."""
BUS_OFF_FROM: Final = 256
"""The transmit counter at this: the controller leaves the bus."""
RECEIVE_COUNT_AFTER_PASSIVE: Final = 127
"""What success leaves of a receive counter that was error-passive (the standard: 119 to 127)."""
SUSPEND_BITS: Final = 8
"""An error-passive sender waits so long after the interframe space before it sends again."""
RECOVERY_SEQUENCES: Final = 128
RECOVERY_BITS: Final = 11
"""A controller comes back from bus-off after 128 times 11 recessive bits in a row."""


class ErrorState(Enum):
    """What a controller may do."""

    ACTIVE = "error-active"
    PASSIVE = "error-passive"
    BUS_OFF = "bus-off"


class Count(Enum):
    """What happens to a controller, and what it does to its counters: see `CHANGE`."""

    SENT = "a frame of its own went through"
    RECEIVED = "a frame of somebody else's went through"
    SEND_ERROR = "its frame was disturbed"
    HEARD_ERROR = "it saw another's error flag"
    FOUND_ERROR = "it saw the error first: the others' flags follow on its own"
    NOT_ACKNOWLEDGED = "nobody acknowledged its frame"


CHANGE: Final[dict[Count, tuple[int, int]]] = {
    Count.SENT: (-1, 0),
    Count.RECEIVED: (0, -1),
    Count.SEND_ERROR: (8, 0),
    Count.HEARD_ERROR: (0, 1),
    Count.FOUND_ERROR: (0, 1 + 8),
    Count.NOT_ACKNOWLEDGED: (8, 0),
}
"""Added to the transmit and to the receive counter."""


class MailboxOrder(Enum):
    """Which of its waiting frames a controller offers."""

    PRIORITY = "lowest identifier first"
    FIFO = "in the order of sending"


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerSettings:
    """How a node's controller is set up.

    Attributes:
        order: which waiting frame goes first.
        depth: how many may wait; one more is refused, as by a full transmit queue.
        restart_ns: from bus-off to the begin of recovery (`ip link ... restart-ms`); None: never.
    """

    order: MailboxOrder = MailboxOrder.PRIORITY
    depth: int = 64
    restart_ns: int | None = 100_000_000

    def __post_init__(self) -> None:
        """Refuses what no controller can be."""
        if self.depth < 1:
            raise ValueError(f"depth {self.depth}: at least 1")
        if self.restart_ns is not None and self.restart_ns < 0:
            raise ValueError(f"restart_ns {self.restart_ns}: at least 0, or None")


DEFAULT_SETTINGS: Final = ControllerSettings()


class Controller:
    """A controller's counters and its frames behind the one it offers.

    Attributes:
        transmit_errors, receive_errors: the two counters.
        waiting: frames that were accepted and have not gone through.
        behind: of these, with FIFO order, all but the one that takes part in arbitration.
        depth, is_fifo: of the settings.
        refused: frames that were not accepted, so far.
        absence: counts the times it has been off the bus.
    """

    __slots__ = (
        "absence",
        "behind",
        "depth",
        "is_fifo",
        "name",
        "receive_errors",
        "refused",
        "settings",
        "state",
        "transmit_errors",
        "waiting",
    )

    def __init__(self, name: str, settings: ControllerSettings = DEFAULT_SETTINGS) -> None:
        self.name = name
        self.settings = settings
        self.depth = settings.depth
        self.is_fifo = settings.order is MailboxOrder.FIFO
        self.state = ErrorState.ACTIVE
        self.transmit_errors = 0
        self.receive_errors = 0
        self.waiting = 0
        self.behind: deque[Frame] = deque()
        self.refused = 0
        self.absence = 0

    @property
    def is_on_bus(self) -> bool:
        """Whether it sends, receives and acknowledges."""
        return self.state is not ErrorState.BUS_OFF

    @property
    def is_clean(self) -> bool:
        """Whether success would change nothing."""
        return not (self.transmit_errors or self.receive_errors)

    def accept(self, frame: Frame) -> bool:
        """Takes a frame to be sent; True if it takes part in arbitration at once."""
        if self.waiting >= self.depth or self.state is ErrorState.BUS_OFF:
            self.refused += 1
            return False
        self.waiting += 1
        if self.is_fifo and self.waiting > 1:
            self.behind.append(frame)
            return False
        return True

    def drop_out(self) -> None:
        """Is off the bus, and forgets what waits."""
        self.state = ErrorState.BUS_OFF
        self.absence += 1
        self.waiting = 0
        self.behind.clear()

    def count(self, what: Count) -> None:
        """Counts, and changes the state accordingly."""
        if what is Count.NOT_ACKNOWLEDGED and self.state is ErrorState.PASSIVE:
            return  # alone on the bus, a controller never counts itself off it
        if what is Count.RECEIVED and self.receive_errors >= ERROR_PASSIVE_FROM:
            self.receive_errors = RECEIVE_COUNT_AFTER_PASSIVE
        else:
            transmit, receive = CHANGE[what]
            self.transmit_errors = max(self.transmit_errors + transmit, 0)
            self.receive_errors = max(self.receive_errors + receive, 0)
        self.state = self._state_of_counters()

    def reset(self) -> None:
        """After recovery, or power-on."""
        self.transmit_errors = self.receive_errors = 0
        self.state = ErrorState.ACTIVE

    def _state_of_counters(self) -> ErrorState:
        if self.state is ErrorState.BUS_OFF or self.transmit_errors >= BUS_OFF_FROM:
            return ErrorState.BUS_OFF
        worst = max(self.transmit_errors, self.receive_errors)
        return ErrorState.PASSIVE if worst >= ERROR_PASSIVE_FROM else ErrorState.ACTIVE
