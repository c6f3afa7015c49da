"""Which way the drive turns, and when it may turn round."""

from __future__ import annotations

from typing import Final

from oracle.property import Complain, Property
from oracle.sample import Sample
from oracle.scene import Scene
from oracle.settings import Settings
from oracle.words import NS_PER_MS

STANDING_MPS: Final = 0.15
"""True speed of a car whose wheels read as standing (0.1 m/s), and their sensors' lag."""
SILENT_NS: Final = 40 * NS_PER_MS
"""The hardware's watchdog opens the contact of a throttle ECU that is silent for 50 ms."""
DRIVEN_RATIO: Final = 0.0075
"""The traction controller's torque is gone when the contact switches; of the motor's full torque
(1 N.m of TABBY EVO's)."""


class TurnsRoundStanding(Property):
    """While the relay is closed the drive turns round at standstill alone, without torque.

    docs/safety.md, driving backwards.
    """

    name = "the drive turns round at standstill"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._was_reverse: bool | None = None
        self._driven_nm = DRIVEN_RATIO * settings.motor_torque_nm_full
        self._throttle = scene.channels["THROTTLE_STATUS"]

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Looks at the reverse contact; where relay or watchdog opens it, nobody has switched."""
        before = self._was_reverse
        self._was_reverse = sample.reverse_selected if sample.relay_closed else None
        if before is None or not sample.relay_closed or before is sample.reverse_selected:
            return
        if now_ns - self._throttle.heard_ns > SILENT_NS:
            return
        is_pushed = abs(sample.drive_torque_nm) > self._driven_nm
        if abs(sample.speed_mps) > STANDING_MPS or is_pushed:
            self.violated(
                now_ns,
                f"{'to reverse' if sample.reverse_selected else 'to forwards'} at "
                f"{sample.speed_mps:.2f} m/s with {sample.drive_torque_nm:.1f} N.m",
            )
