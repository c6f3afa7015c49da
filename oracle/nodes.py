"""Single nodes: who sends what, and who may come back."""

from __future__ import annotations

from typing import Final

from oracle.decode import Message
from oracle.property import Complain, Property, ms
from oracle.sample import Sample
from oracle.scene import Scene
from oracle.settings import SILENT_NS, Settings
from oracle.words import AXES, HEARTBEATS, NEVER_NS, NS_PER_MS, HeartbeatState, NodeState

COMMAND_SILENT_NS: Final = 115 * NS_PER_MS
"""The gateway's frames come every 20 ms and time out after 100."""
LEAVE_NS: Final = 100 * NS_PER_MS
"""A drive with a node that was away ends within this."""
OBEY_NS: Final = 50 * NS_PER_MS
"""By then a node that has come back has heard the supervisor, or gone to its own safe state."""

SILENT_NS_OF: Final = {
    "SUPERVISOR_STATE": SILENT_NS,
    "STEER_STATUS": SILENT_NS,
    "THROTTLE_STATUS": SILENT_NS,
    "BRAKE_STATUS": SILENT_NS,
    "SAFETY_VERDICT": SILENT_NS,
    "STEER_COMMAND": COMMAND_SILENT_NS,
}
"""By which frames a node shows that it is there, and the gap that shows it was not."""
DRIVERS: Final = tuple(f"{prefix}_DRIVER" for prefix in AXES)


class RejoinsByRearming(Property):
    """A node that was away (restarted, bus-off, silent) ends the drive, and drives no more in it.

    Design (driving modes), docs/safety.md: a node that restarts while the car moves joins
    unauthorised and waits for re-arming. Away is a boot-up, or frames that were missing for longer
    than the supervisor waits; ACTIVE soon after in the same drive breaks the property, and so does
    a drive that goes on.
    """

    name = "a node rejoins only by re-arming"
    watches = (*DRIVERS, *HEARTBEATS)

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._channels = [(scene.channels[name], span) for name, span in SILENT_NS_OF.items()]
        self._state = scene.channels["SUPERVISOR_STATE"]
        self._drivers = {
            node: scene.channels[f"{prefix}_DRIVER"] for prefix, node in AXES.items()
        }
        self._away: set[str] = set()
        self._back: dict[str, tuple[int, int]] = {}  # node: drive, since when it is back
        self._is_active: dict[str, bool] = {}
        self._told: set[tuple[str, int]] = set()

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Notes whose frames are missing, and who is back."""
        if not self.scene.is_driving:
            if self._away or self._back:
                self._away.clear()
                self._back.clear()
            return
        if self._back:
            self._judge_drive(now_ns)
        for channel, span_ns in self._channels:
            assert channel.sender is not None
            if now_ns - channel.heard_ns > span_ns:
                self._away.add(channel.sender)
            elif channel.sender in self._away:
                self._away.remove(channel.sender)
                self._is_back(now_ns, channel.sender)

    def on_message(self, now_ns: int, message: Message) -> None:
        """A boot-up; what an actuator node does."""
        if not message.is_genuine or not message.values:
            return
        name, node, scene = message.name, message.sender, self.scene
        if name in HEARTBEATS:
            if message.values["state"] == HeartbeatState.BOOT_UP and scene.is_driving:
                self._is_back(now_ns, node)
        else:
            self._is_active[node] = message.values["node_state"] == NodeState.ACTIVE

    def _is_back(self, now_ns: int, node: str) -> None:
        if self._back.get(node, (0, 0))[0] != self.scene.drive:
            self._back[node] = self.scene.drive, now_ns

    def _judge_drive(self, now_ns: int) -> None:
        """Neither drives a node that is back, nor goes the drive on for long."""
        scene = self.scene
        for node, (drive, since_ns) in self._back.items():
            back_ns = now_ns - since_ns
            if drive != scene.drive:
                continue
            if back_ns > OBEY_NS and self._drives(node, since_ns):
                self._tell(now_ns, node, f"ACTIVE {ms(back_ns)} after it came back")
            elif self._state.heard_ns - since_ns > LEAVE_NS:  # the supervisor still says so
                self._tell(now_ns, node, f"{scene.mode.name} goes on after it was away")

    def _drives(self, node: str, since_ns: int) -> bool:
        """It says so, and has said anything since it is back and since its last boot-up."""
        is_active = self._is_active.get(node, False)
        booted_ns = self.scene.booted_ns.get(node, NEVER_NS)
        return is_active and self._drivers[node].heard_ns > max(since_ns, booted_ns)

    def _tell(self, now_ns: int, node: str, text: str) -> None:
        key = node, self.scene.drive
        if key not in self._told:
            self._told.add(key)
            self.violated(now_ns, f"{node}: {text}")


class OneSender(Property):
    """No node sends an identifier that is another's.

    docs/architecture.md, identifiers: two nodes that send the same one with different data do not
    arbitrate, they collide. By true senders; a stranger's frames are counted, not complained of.
    """

    name = "one sender per identifier"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._told: set[tuple[int, str]] = set()

    def on_other(self, now_ns: int, can_id: int, sender: str, owner: str | None) -> None:
        """A frame of a node that the DBC does not name for it; told once."""
        if (can_id, sender) not in self._told:
            self._told.add((can_id, sender))
            belongs = f"is {owner}'s" if owner else "is nobody's"
            self.violated(now_ns, f"{sender} sends 0x{can_id:03X}, which {belongs}")
