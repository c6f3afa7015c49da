"""What the oracle found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

CRC_MISS_SHARE: Final = 1 / 256
"""Share of random corruptions that a CRC of 8 bits cannot see."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """A property that did not hold.

    Attributes:
        property: Its name.
        true_ns: When it was found broken.
        text: In words, with numbers.
    """

    property: str
    true_ns: int
    text: str

    def __str__(self) -> str:
        """As a line of a report."""
        return f"{self.true_ns / 1e9:.3f} s: {self.property}: {self.text}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reaction:
    """What a hazardous fault was answered by; times in ms from its beginning, None: never.

    Attributes:
        kind: What went wrong, in the injector's words.
        target: Of which node or part.
        true_ns: When it began.
        emergency_ms: Until EMERGENCY_BRAKE was on the bus.
        setpoint_ms: Until the servo was sent to its end.
        brake_ms: Until it was at 90 %.
        standstill_ms: Until the car stood.
        is_missed: It was due, and there was no answer.
        is_moot: Without an answer: the driver took the car, or it went, before it was due.
    """

    kind: str
    target: str
    true_ns: int
    emergency_ms: float | None
    setpoint_ms: float | None
    brake_ms: float | None
    standstill_ms: float | None
    is_missed: bool
    is_moot: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Corruptions:
    """Frames that were changed on their way and yet went through.

    Attributes:
        count: All of them.
        unseen: Those whose CRC-8 fits all the same.
    """

    count: int
    unseen: int

    @property
    def unseen_expected(self) -> float:
        """How many a CRC-8 is expected not to see."""
        return self.count * CRC_MISS_SHARE


@dataclass(frozen=True, slots=True, kw_only=True)
class OracleReport:
    """Everything at the end.

    Attributes:
        violations: In the order of finding; at most a handful of each property.
        excused: The same of what an active fault puts beyond a property.
        counts: Violations by property, all of them.
        reactions: One for every hazardous fault that began while the car drove itself.
        strangers: Frames of stations that are not in the DBC.
        corruptions: Told by `on_corruption`.
    """

    violations: tuple[Violation, ...]
    excused: tuple[Violation, ...]
    counts: dict[str, int]
    reactions: tuple[Reaction, ...]
    strangers: int
    corruptions: Corruptions

    def __str__(self) -> str:
        """The violations, one a line; a word if there are none."""
        return "\n".join(map(str, self.violations)) or "no violation"
