"""What the rules of cause look at, and the words they share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from dbc.messages import Mode
from gateway.sentences import NODE_TEXT
from telemetry.why.incident import Cause, Claim
from telemetry.why.window import Window
from vehicles import Vehicle

NS_PER_MS: Final = 1_000_000
NS_PER_S: Final = 1_000_000_000
SOON_NS: Final = 100 * NS_PER_MS
"""What is said this much later may still be about the same cause: any fault's time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """One incident's.

    Attributes:
        window: The frames around it.
        claims: What was said, from shortly before it.
        at_ns: When the first frame showed it.
        mode_before: The driving mode until then.
        vehicle: What the nodes believe about the car.
    """

    window: Window
    claims: list[Claim]
    at_ns: int
    mode_before: Mode | None
    vehicle: Vehicle

    @property
    def calls(self) -> list[Claim]:
        """Wishes to brake, in order."""
        return [claim for claim in self.claims if claim.is_call]


Rule = Callable[[Evidence, Claim], Iterator[Cause]]
"""What a claim leads to."""


def node_text(node: str | None) -> str:
    """A node in words."""
    return NODE_TEXT.get(node or "", "somebody")


def ms(span_ns: int) -> str:
    """A span in words."""
    return f"{span_ns / NS_PER_MS:.0f} ms"
