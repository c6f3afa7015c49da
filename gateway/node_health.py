"""The nodes as a planner sees them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from dbc.messages import ErrorCode, HeartbeatState, NodeState


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeHealth:
    """One node as heard over the bus."""

    heartbeat: HeartbeatState | None
    """NMT state; None when no heartbeat comes."""
    age_s: float
    """Age of its newest protected 10 ms frame; infinite before the first."""
    is_heard: bool
    """Whether that frame came within the DBC's time-out."""
    node_state: NodeState | None
    """State of a steer, throttle or brake node; None when not told or too old."""
    codes: tuple[ErrorCode, ...] | None
    """Codes it reports in its driver frame; None when that frame is too old."""

    @property
    def is_healthy(self) -> bool:
        """Operational, heard, without a code, in no safe state. Missing data is unhealthy."""
        return (
            self.is_heard
            and self.heartbeat is HeartbeatState.OPERATIONAL
            and self.codes == ()
            and self.node_state in (None, NodeState.RELEASED, NodeState.ACTIVE)
        )


class HealthByNode(Mapping[str, NodeHealth]):
    """Read-only, and unlike a mapping proxy it can be pickled and copied."""

    def __init__(self, health: Mapping[str, NodeHealth]) -> None:
        self._health = dict(health)

    def __getitem__(self, node: str) -> NodeHealth:
        """The node's health; KeyError for a name that is not in the DBC."""
        return self._health[node]

    def __iter__(self) -> Iterator[str]:
        """The nodes' names."""
        return iter(self._health)

    def __len__(self) -> int:
        """How many nodes there are."""
        return len(self._health)

    def __repr__(self) -> str:
        """As the dict it is made from."""
        return repr(self._health)
