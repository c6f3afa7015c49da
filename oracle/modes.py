"""The driving mode: its order, what it authorises, how it begins, how it is left."""

from __future__ import annotations

from typing import Final

from oracle.deadlines import Deadline
from oracle.decode import Message
from oracle.property import Complain, Once, Property
from oracle.sample import Sample
from oracle.scene import Scene
from oracle.settings import Settings
from oracle.words import DRIVING, GAP_NS, NEVER_NS, NS_PER_MS, Mode

_M = Mode
MAY_FOLLOW: Final[dict[Mode, frozenset[Mode]]] = {
    _M.INIT: frozenset({_M.MANUAL, _M.EMERGENCY}),
    _M.MANUAL: frozenset({_M.READY}),
    _M.READY: frozenset({_M.MANUAL, _M.AUTOMATIC, _M.EMERGENCY}),
    _M.AUTOMATIC: frozenset({_M.MANUAL, _M.STOPPING, _M.EMERGENCY}),
    _M.STOPPING: frozenset({_M.MANUAL, _M.READY, _M.EMERGENCY}),
    _M.EMERGENCY: frozenset({_M.MANUAL}),
}
"""docs/architecture.md, driving modes; INIT follows on nothing but a restart."""

BOOT_NS: Final = 50 * NS_PER_MS

AUTHORISED: Final[dict[Mode, frozenset[str]]] = {
    _M.INIT: frozenset(),
    _M.MANUAL: frozenset(),
    _M.READY: frozenset(),
    _M.AUTOMATIC: frozenset({"steering", "throttle", "brake"}),
    _M.STOPPING: frozenset({"steering", "throttle", "brake"}),
    _M.EMERGENCY: frozenset({"steering", "brake"}),
}
"""Design, driving modes: in an emergency traction is cut, under a human nothing is authorised."""


class ModeOrder(Property):
    """Modes follow each other as documented; READY after a controlled stop only at standstill.

    docs/architecture.md, driving modes. INIT needs a boot-up of the supervisor. Where frames of
    its state are missing nothing is concluded.
    """

    name = "modes in order"
    watches = ("SUPERVISOR_STATE",)

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._mode: Mode | None = None
        self._state = scene.channels["SUPERVISOR_STATE"]
        self._boot = Deadline(BOOT_NS)
        self._booted_after_ns = 0

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """A boot-up, which yields to the first state on the bus, must have been heard by now."""
        if self._boot.is_overdue(now_ns):
            self._boot.answer()
            if self.scene.booted_ns.get("Supervisor", NEVER_NS) < self._booted_after_ns:
                self.violated(now_ns, "INIT without a restart")

    def on_message(self, now_ns: int, message: Message) -> None:
        """Compares with the mode before."""
        if not message.is_genuine or not message.values:
            return
        before, self._mode = self._mode, self.scene.mode
        mode, heard_ns = self._mode, self._state.before_ns
        if before is None or before is mode:
            return
        if mode is Mode.INIT:
            self._booted_after_ns = heard_ns - GAP_NS
            self._boot.start(now_ns)
        elif now_ns - heard_ns <= GAP_NS and mode not in MAY_FOLLOW[before]:
            self.violated(now_ns, f"{before.name} -> {mode.name}")
        speed_mps = self.scene.sample.speed_mps
        if (before, mode) == (Mode.STOPPING, Mode.READY) and (
            abs(speed_mps) > self.settings.standing_mps
        ):
            self.violated(now_ns, f"STOPPING -> READY at {speed_mps:.2f} m/s")


class Authorisation(Property):
    """The supervisor authorises only the axes of its mode: none under a human, no traction in
    an emergency (design, driving modes)."""

    name = "authorisation by mode"
    watches = ("SUPERVISOR_STATE",)

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._once = Once()

    def on_message(self, now_ns: int, message: Message) -> None:
        """Looks at the three bits."""
        if not message.is_genuine or not message.values:
            return
        values, mode = message.values, self.scene.mode
        if mode in DRIVING:
            return
        given = {axis for axis in ("steering", "throttle", "brake") if values[f"{axis}_authorised"]}
        wrong = given - AUTHORISED[mode]
        if self._once.begins(bool(wrong)):
            self.violated(now_ns, f"{', '.join(sorted(wrong))} authorised in {mode.name}")
