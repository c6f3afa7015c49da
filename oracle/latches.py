"""What never clears by itself: codes and the emergency."""

from __future__ import annotations

from typing import Final

from oracle.deadlines import Lately
from oracle.decode import Message
from oracle.property import Complain, Property
from oracle.sample import Sample
from oracle.scene import Scene
from oracle.settings import Settings
from oracle.words import AT_WORK, AXES, ER0, NS_PER_MS, Mode, Request

EPOCHS: Final = 16
RESET_NS: Final = 50 * NS_PER_MS
"""By then every node has heard the new epoch."""
BOOT_NS: Final = 100 * NS_PER_MS
"""By then a node that has booted tells its codes anew."""
ASKED_NS: Final = 200 * NS_PER_MS
"""Between asking for a reset and MANUAL: the request is repeated every 20 ms."""


class CodesLatched(Property):
    """A code raised while the car drives itself, or brakes, is told until the reset epoch rises.

    docs/safety.md, error codes; ER0 apart, which latches nothing. A node that restarts forgets.
    """

    name = "codes latched until the reset"
    watches = tuple(f"{prefix}_DRIVER" for prefix in AXES)

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._epoch = 0
        self._raised_ns = 0
        self._latched = dict.fromkeys(AXES.values(), 0)
        self._before = dict.fromkeys(AXES.values(), (0, False))
        self._status = {
            node: scene.channels[f"{prefix}_STATUS"] for prefix, node in AXES.items()
        }

    def on_message(self, now_ns: int, message: Message) -> None:
        """Compares the codes with those that the node has latched."""
        if not message.is_genuine or not message.values:
            return
        node, values = message.sender, message.values
        if self.scene.epoch != self._epoch:
            self._epoch = self.scene.epoch
            self._raised_ns = now_ns
            self._latched = dict.fromkeys(AXES.values(), 0)
        codes, is_at_work = int(values["codes"]) & ~ER0, int(values["node_state"]) in AT_WORK
        codes_before, was_at_work = self._before[node]
        self._before[node] = codes, is_at_work
        if self.scene.booted_ns.get(node, -1) > now_ns - BOOT_NS:
            self._latched[node] = 0
            return
        lost = self._latched[node] & ~codes
        if lost:
            names = ", ".join(f"ER{n}" for n in range(7) if lost >> n & 1)
            self.violated(now_ns, f"{node} no longer tells {names}, epoch {self._epoch}")
        self._latched[node] &= codes
        status = self._status[node]
        was_away = status.lost_ns <= self._raised_ns <= status.resumed_ns  # when it was raised
        told_ns = status.resumed_ns if was_away else self._raised_ns
        is_settled = now_ns - told_ns > RESET_NS and not self.scene.was_unheard(now_ns)
        if is_at_work and was_at_work and is_settled:
            self._latched[node] |= codes & ~codes_before


class EmergencyLatched(Property):
    """EMERGENCY is left only to MANUAL, by an explicit reset at standstill that raises the epoch.

    docs/safety.md, engaging and resetting. The reset is the planner's request or the button; on a
    bus that carried nothing it may have been long ago. A supervisor that restarts finds the
    emergency and adopts it; it is over if all actuator nodes have restarted too.
    """

    name = "emergency latched until the reset"
    watches = ("SUPERVISOR_STATE",)

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._since_ns: int | None = None
        self._epoch = 0
        self._asked = Lately(ASKED_NS)

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """The button asks for a reset."""
        if sample.button_pressed:
            self._asked.note(now_ns)

    def on_message(self, now_ns: int, message: Message) -> None:
        """Follows mode and epoch."""
        if not message.is_genuine or not message.values:
            return
        scene = self.scene
        if scene.mode is Mode.EMERGENCY:
            if self._since_ns is None:
                self._since_ns = now_ns
            self._epoch = scene.epoch
        elif self._since_ns is not None and scene.mode is not Mode.INIT:
            wrong = self._wrong(now_ns)
            if wrong:
                self.violated(now_ns, f"EMERGENCY -> {scene.mode.name}: {', '.join(wrong)}")
            self._since_ns = None

    def _wrong(self, now_ns: int) -> list[str]:
        """What was not as it should be."""
        scene, since_ns = self.scene, self._since_ns
        assert since_ns is not None
        booted_ns = scene.booted_ns
        if all(booted_ns.get(node, -1) > since_ns for node in (*AXES.values(), "Supervisor")):
            return []
        speed_mps = scene.sample.speed_mps
        was_unheard = scene.was_unheard(now_ns)
        rules = (
            (not was_unheard and scene.mode is not Mode.MANUAL, "not to MANUAL"),
            (scene.epoch != (self._epoch + 1) % EPOCHS, f"epoch {self._epoch} -> {scene.epoch}"),
            (abs(speed_mps) > self.settings.standing_mps, f"at {speed_mps:.2f} m/s"),
            (not (was_unheard or self._is_asked(now_ns)), "nobody asked"),
        )
        return [text for holds, text in rules if holds]

    def _is_asked(self, now_ns: int) -> bool:
        """By the button or by the planner."""
        request = self.scene.channels["MODE_REQUEST"]
        is_requested = (
            request.newest is not None
            and request.newest.values["request"] == Request.RESET
            and now_ns - request.newest_ns <= ASKED_NS
        )
        return is_requested or self._asked.was(now_ns)
