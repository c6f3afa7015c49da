"""NMT starts of the motor drives on the bus: the supervisor is the only NMT master.

Whether a drive is well is its ECU's business; here it is told to start, whenever it is heard and
is not OPERATIONAL, as after its power came back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from canbus.canopen_protocol import HEARTBEAT_ID, NmtCommand, NmtState, heartbeat_state, nmt_frame
from canbus.frame import Frame, ReceivedFrame
from ecus.supervisor.nodes import START_INTERVAL_NS


class DriveStarts:
    """The drives by their heartbeats.

    Args:
        node_ids: of the drives; none on most cars.
    """

    def __init__(self, node_ids: Iterable[int]) -> None:
        self._node_of_heartbeat = {HEARTBEAT_ID + node_id: node_id for node_id in node_ids}
        self._states: dict[int, NmtState] = {}
        self._due_ns = dict.fromkeys(self._node_of_heartbeat.values(), 0)

    def take(self, received: Sequence[ReceivedFrame]) -> None:
        """Takes this step's heartbeats in; a malformed one tells nothing."""
        if not self._node_of_heartbeat:
            return
        for item in received:
            node_id = self._node_of_heartbeat.get(item.frame.can_id)
            state = None if node_id is None else heartbeat_state(item.frame)
            if node_id is not None and state is not None:
                self._states[node_id] = state

    def starts(self, now_ns: int) -> list[Frame]:
        """The starts that are due now: each drive's at most every `START_INTERVAL_NS`."""
        frames = []
        for node_id, state in self._states.items():
            if state is not NmtState.OPERATIONAL and now_ns >= self._due_ns[node_id]:
                self._due_ns[node_id] = now_ns + START_INTERVAL_NS
                frames.append(nmt_frame(NmtCommand.START, node_id))
        return frames
