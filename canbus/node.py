"""The node contract: what goes into a step and what comes out. Plain data, standard library only.

A node is cyclic and does no I/O: `output = node.step(now_ns, received, sensors)`. The caller gives
the time, every frame since the last step with its arrival time, and the sensors' readings; the
answer holds the frames to send, the actuators' command and what there is to report.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Generic, Protocol, TypeVar

from canbus.frame import Frame, ReceivedFrame

PERIOD_NS: Final = 10_000_000
"""Every node's cycle: 10 ms (design; UAH's 100 ms, UWA's loop, are slower)."""

EARS_NS: Final = PERIOD_NS
"""A node's first step hears what came in the cycle before it, and nothing older: else what it has
heard would depend on how long its start took, and no log could tell."""

NODE_IDS: Final = {
    "Supervisor": 1,
    "Steering": 2,
    "Throttle": 3,
    "BrakeServo": 4,
    "SafetyMonitor": 5,
    "Gateway": 6,
}
"""CANopen node ids by the DBC's node names."""


class EventKind(StrEnum):
    """What a node may report besides its frames."""

    MODE = "mode"
    STATE = "state"
    CODE = "code"
    FRAME = "frame"
    FOREIGN = "foreign"
    OVERRUN = "overrun"
    NMT = "nmt"
    PARAMETER = "parameter"
    VERDICT = "verdict"


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """One thing worth a line in a log, on the node's own clock."""

    time_ns: int
    node: str
    kind: EventKind
    text: str


SensorsT = TypeVar("SensorsT", contravariant=True)
ActuatorT = TypeVar("ActuatorT", covariant=True)


class StepOutput(Generic[ActuatorT]):
    """A step's answer. `actuator` is the command to the hardware, in force until the next step."""

    __slots__ = ("actuator", "events", "frames")

    def __init__(
        self, *, frames: Sequence[Frame], actuator: ActuatorT, events: Sequence[Event]
    ) -> None:
        self.frames: Final = frames
        self.actuator = actuator
        self.events: Final = events


class Node(Protocol[SensorsT, ActuatorT]):
    """A sans-I/O node."""

    name: str
    acceptance: frozenset[int] | None
    """Identifiers the node wants; None for all."""

    def step(
        self, now_ns: int, received: Sequence[ReceivedFrame], sensors: SensorsT
    ) -> StepOutput[ActuatorT]:
        """One cycle. `now_ns` never goes back; `received` is in order of arrival."""
        ...
