"""How AUTOMATIC and a start-up begin."""

from __future__ import annotations

from typing import Final

from oracle.deadlines import Deadline, Lately, Told
from oracle.decode import Message, channels
from oracle.property import Complain, Property, ms
from oracle.sample import Sample
from oracle.scene import Fault, Scene
from oracle.settings import Settings
from oracle.words import (
    AXES,
    HEARTBEATS,
    NS_PER_MS,
    NS_PER_S,
    HeartbeatState,
    Mode,
    NodeState,
    Request,
    Verdict,
)

STEP_NS: Final = 20 * NS_PER_MS
"""From the frame that decided to the frame that tells: two cycles."""
REQUEST_NS: Final = 100 * NS_PER_MS
BUTTON_NS: Final = 150 * NS_PER_MS
"""From the push to READY: debounced for 30 ms, in a node that may be 50 ms late."""
STARTED_NS: Final = 2 * NS_PER_S
RESTARTED_NS: Final = 3 * NS_PER_S
"""A node that comes back is out of sequence: ER0, which is told for a second and denies."""
OTHERS: Final = frozenset(HEARTBEATS.values()) - {"Supervisor"}
DRIVERS: Final = tuple(f"{prefix}_DRIVER" for prefix in AXES)
TIMEOUTS_NS: Final = {
    channel.name: channel.timeout_ns
    for channel in channels().values()
    if channel.timeout_ns and channel.sender in OTHERS
}
"""Cyclic messages of the other nodes, by the DBC."""
MEANING: Final = {"SAFETY_VERDICT": "PERMIT"} | {
    name: f"a node that is released, without code and driver ({name})" for name in DRIVERS
}


class EngagedInOrder(Property):
    """AUTOMATIC needs the button, then a request, all nodes well, no code, and PERMIT; each fresh.

    docs/safety.md, engaging and resetting. Every condition must have been seen on the wire within
    its own time-out and two cycles: the supervisor may have heard less than was sent, never more.
    """

    name = "engaged in order"
    watches = ("SUPERVISOR_STATE", "SAFETY_VERDICT", *DRIVERS)

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._pushed = Lately(BUTTON_NS)
        self._is_down = True
        self._is_ready = False
        self._mode = Mode.INIT
        self._well = {name: Told() for name in ("SAFETY_VERDICT", *DRIVERS)}
        self._calm = Lately(STEP_NS + 2 * settings.sample_ns)

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """The button, and the emergency stop that is not pressed."""
        if sample.button_pressed and not self._is_down:
            self._pushed.note(now_ns)
        self._is_down = sample.button_pressed
        if not sample.emergency_stop_pressed:
            self._calm.note(now_ns)

    def on_message(self, now_ns: int, message: Message) -> None:
        """Keeps when each condition was last seen, and judges at AUTOMATIC."""
        name, values = message.name, message.values
        if not message.is_genuine or not values:
            return
        if name == "SUPERVISOR_STATE":
            before, self._mode = self._mode, self.scene.mode
            if before is not self._mode:
                self._on_mode(now_ns, before)
        elif name == "SAFETY_VERDICT":
            self._well[name].update(now_ns, values["verdict"] == Verdict.PERMIT)
        else:
            is_calm = not values["codes"] and not values["driver_active"]
            is_released = values["node_state"] == NodeState.RELEASED
            self._well[name].update(now_ns, is_calm and is_released)

    def _on_mode(self, now_ns: int, before: Mode) -> None:
        if self._mode is Mode.READY:
            is_pushed = self._pushed.was(now_ns) or self.scene.was_unheard(now_ns)
            self._is_ready = before is Mode.STOPPING or is_pushed
            return
        if self._mode is Mode.AUTOMATIC:
            missing = self._missing(now_ns)
            if missing:
                self.violated(now_ns, f"without {', '.join(missing)}")
        self._is_ready = False

    def _missing(self, now_ns: int) -> list[str]:
        """What was not there."""
        channels = self.scene.channels
        request = channels["MODE_REQUEST"]
        is_asked = request.newest is not None and (
            request.newest.values["request"] == Request.ENGAGE
        )
        rules = [
            (self._is_ready, "the button"),
            (is_asked and now_ns - request.newest_ns <= REQUEST_NS, "a request"),
            (self._calm.was(now_ns), "the emergency stop released"),
        ]
        for name, timeout_ns in TIMEOUTS_NS.items():
            channel, span_ns = channels[name], timeout_ns + STEP_NS
            if name in self._well:
                is_there = self._well[name].was(now_ns, channel.heard_ns, span_ns)
            else:
                is_there = now_ns - channel.heard_ns <= span_ns
            if name in HEARTBEATS and channel.newest is not None:
                is_there &= channel.newest.values["state"] == HeartbeatState.OPERATIONAL
            rules.append((is_there, MEANING.get(name, name)))
        return [text for holds, text in rules if not holds]


class StartsUp(Property):
    """A start is no deadlock: MANUAL with PERMIT within 2 s after all nodes live, nothing faulty.

    Design: a verdict of DENY at start-up is no emergency, so neither waits for the other. Counts
    anew after every fault, stranger and boot-up; after a restart a second more.
    """

    name = "start-up ends in MANUAL with PERMIT"
    watches = ("SAFETY_VERDICT", *HEARTBEATS)

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._due = Deadline(STARTED_NS)
        self._heard: set[str] = set()
        self._is_permitted = False
        self._is_done = False
        self._verdict = Verdict.DENY

    def on_fault(self, now_ns: int, fault: Fault, *, is_begin: bool) -> None:
        """The time begins anew."""
        self._due.answer()

    def on_message(self, now_ns: int, message: Message) -> None:
        """Follows heartbeats, mode and verdict."""
        if not message.is_genuine or not message.values:
            self._due.answer()
            return
        if message.name == "SAFETY_VERDICT":
            self._verdict = Verdict(int(message.values["verdict"]))
        elif message.name in HEARTBEATS:
            self._heard.add(message.sender)
            if message.values["state"] == HeartbeatState.BOOT_UP:
                if self._is_done:
                    self._due.span_ns = RESTARTED_NS
                self._is_done = False
                self._due.answer()

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Counts the time."""
        if self._is_done:
            return
        scene = self.scene
        is_started = scene.mode is Mode.MANUAL and self._verdict is Verdict.PERMIT
        if is_started or scene.mode not in (Mode.INIT, Mode.MANUAL):
            self._is_done = is_started or self._is_done
            self._due.answer()
            return
        is_calm = not scene.faults and not sample.emergency_stop_pressed
        if is_calm and len(self._heard) == len(HEARTBEATS):
            self._due.start(now_ns)
        else:
            self._due.answer()
        if self._due.is_overdue(now_ns):
            self._is_done = True
            self.violated(
                now_ns, f"{scene.mode.name} with {self._verdict.name} after {ms(self._due.span_ns)}"
            )
