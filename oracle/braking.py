"""What the emergency brake does, and when it must not."""

from __future__ import annotations

from math import copysign, inf
from typing import Final

from oracle.deadlines import Held
from oracle.decode import Message
from oracle.property import Complain, Once, Property, ms
from oracle.sample import Sample
from oracle.scene import Scene
from oracle.settings import Settings
from oracle.words import BRAKE_FRAMES, DRIVING, NS_PER_MS, Mode, Verdict

ROLLING_NS: Final = 100 * NS_PER_MS
"""A car that begins to roll (ER3) is braked again within this."""
RESTARTED_NS: Final = 30 * NS_PER_MS
TRAVEL_MARGIN: Final = 1.3
"""The servo is given so much more than its travel before it counts as dead (docs/safety.md)."""
REGENERATION_LAG_NS: Final = 250 * NS_PER_MS
"""Dead time and lag of the traction controller."""
REGENERATING_MPS: Final = 1.0
"""The motor's regeneration fades below walking pace (5 km/h)."""
SILENT_NS: Final = 100 * NS_PER_MS


class NoDriveWhileBraking(Property):
    """There is no drive torque while the emergency brake is on.

    docs/safety.md, design (driving modes): in an emergency traction is cut. When it has been
    called for as long as the slowest way to notice it takes, and the traction controller's dead
    time, torque only falls; soon there is none.
    """

    name = "no drive torque while emergency braking"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._once = Once()
        self._lowest_nm = inf

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Compares the torque with what is left of it."""
        since_ns = self.scene.braking_since_ns
        if since_ns is None:
            self._once.begins(False)
            self._lowest_nm = inf
            return
        settings = self.settings
        braking_ns = now_ns - since_ns
        if braking_ns <= settings.drive_cut_ns:
            return
        torque_nm = sample.drive_torque_nm  # regeneration that fades would uncover the rest
        allowed_nm = self._lowest_nm if braking_ns <= settings.drive_gone_ns else 0.0
        self._lowest_nm = min(self._lowest_nm, torque_nm)
        if self._once.begins(torque_nm > allowed_nm + settings.drive_torque_nm_max):
            self.violated(now_ns, f"{torque_nm:.1f} N.m {ms(braking_ns)} after the brake's call")


class BrakeKept(Property):
    """In an emergency the brake is not released while the car moves, ER3 or not.

    docs/safety.md (ER3; the driver: "braking stays"). From 100 ms after the call the servo is sent
    to its end; one that rests at standstill is applied again when the car rolls above 0.2 m/s. A
    brake ECU that restarts releases it for two cycles, until it has heard the supervisor.
    """

    name = "brake kept in an emergency"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._moving = Held(ROLLING_NS)
        self._released = Held(RESTARTED_NS)
        self._once = Once()

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Looks at what reaches the servo."""
        since_ns = self.scene.braking_since_ns
        is_moving = self._moving.update(now_ns, abs(sample.speed_mps) > self.settings.moving_mps)
        is_due = since_ns is not None and now_ns - since_ns > self.settings.hazard_ns
        is_released = is_due and is_moving and not sample.is_full_brake_asked
        if self._once.begins(self._released.update(now_ns, is_released)):
            power = "powered" if sample.servo_powered else "unpowered"
            self.violated(
                now_ns,
                f"servo {power}, sent to {sample.servo_target_ratio:.2f} "
                f"at {sample.speed_mps:.2f} m/s",
            )


class RegenerationReplacesServo(Property):
    """If the servo does not brake, the throttle ECU brakes with the regeneration it has.

    docs/safety.md, "if a part dies while AUTOMATIC": the brake servo itself. Where the throttle
    ECU is not heard, nobody can.
    """

    name = "regeneration replaces a dead servo"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        travel_ns = round(TRAVEL_MARGIN * settings.servo_travel_ns)
        self._due_ns = settings.hazard_ns + travel_ns + REGENERATION_LAG_NS
        self._missing = Held(self._due_ns)
        self._once = Once()
        self._throttle = scene.channels["THROTTLE_STATUS"]

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Looks at servo and torque."""
        is_missing = (
            self.scene.braking_since_ns is not None
            and sample.servo_position_ratio < 0.5
            and abs(sample.speed_mps) > REGENERATING_MPS
            and now_ns - self._throttle.heard_ns < SILENT_NS
        )
        is_due = self._missing.update(now_ns, is_missing)
        braking_nm = -copysign(1.0, sample.speed_mps) * sample.motor_torque_nm
        if self._once.begins(is_due and braking_nm < self.settings.regenerating_nm):
            self.violated(
                now_ns,
                f"servo at {sample.servo_position_ratio:.2f}, motor {sample.motor_torque_nm:.1f} "
                f"N.m at {sample.speed_mps:.2f} m/s, {ms(self._due_ns)} long",
            )


class NoFalseEmergency(Property):
    """Nobody brakes without a reason.

    EMERGENCY_BRAKE, a verdict of BRAKE or the mode EMERGENCY follow on a fault, the emergency
    stop, FAILSAFE, the planner's request, a stranger's NMT or forged frame, or by the vehicle's
    policy the driver; the reason is there, or was within the last seconds.
    """

    name = "no emergency brake without a reason"
    watches = (*BRAKE_FRAMES, "SAFETY_VERDICT", "SUPERVISOR_STATE")

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._is_told = False

    def on_message(self, now_ns: int, message: Message) -> None:
        """Looks for the reason once an emergency."""
        if not message.is_genuine or not message.values:
            return
        scene = self.scene
        is_state = message.name == "SUPERVISOR_STATE"
        if is_state and scene.mode is not Mode.EMERGENCY:
            if scene.mode not in DRIVING:
                self._is_told = False
            return
        if message.name == "SAFETY_VERDICT" and message.values["verdict"] != Verdict.BRAKE:
            return
        if not self._is_told:
            self._is_told = True  # judged when it begins: later the reason may be forgotten
            if not scene.has_cause(now_ns):
                text = f"{message.name} of {message.sender} in {scene.mode.name}"
                if not is_state:
                    values = message.values
                    told = [f"{n} {values[n]:g}" for n in ("code", "reason") if n in values]
                    text += f": {', '.join(told)}"
                self.violated(now_ns, text)
