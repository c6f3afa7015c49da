"""The driver: his touch wins, his wheel is his, and nothing moves under him."""

from __future__ import annotations

from typing import Final

from oracle.deadlines import Held
from oracle.decode import Message
from oracle.property import Complain, Once, Property, ms
from oracle.sample import Sample
from oracle.scene import Scene
from oracle.settings import Settings
from oracle.words import ER4_OR_ER6, HUMAN, NS_PER_MS, Mode

RELAY_NS: Final = 15 * NS_PER_MS
"""The relay moves with the step that sends the mode; the look at it may be a sample later."""
RELEASE_NS: Final = 320 * NS_PER_MS
"""The pedal's spring takes an open servo back in 0.25 s, and a margin."""
RELEASED_RATIO: Final = 0.05
PEDAL_NS: Final = 600 * NS_PER_MS
"""Motor torque follows the pedal after dead time and lag; so long ago it may have been further."""
COAST_NS: Final = 25 * NS_PER_MS
"""From the frame that tells ER4 or ER6 to open outputs: a cycle and a sample."""
SETTLED_NS: Final = 200 * NS_PER_MS

ECHOES: Final = {
    "STEER_STATUS": "applied_steering_wheel_angle_rad",
    "THROTTLE_STATUS": "applied_wheel_speed_radps",
    "BRAKE_STATUS": "applied_position_ratio",
}
"""The signal of each status message that tells the setpoint in force."""


class Touch:
    """One control: since when the driver has used it, and whether he has for long enough."""

    __slots__ = ("_debounced", "is_sure", "since_ns")

    def __init__(self, debounce_ns: int) -> None:
        self._debounced = Held(debounce_ns)
        self.since_ns: int | None = None
        self.is_sure = False

    def update(self, now_ns: int, is_touched: bool) -> None:
        """Takes a look in; a sure touch stays one until `forget`."""
        was_sure = self.is_sure
        self.is_sure |= self._debounced.update(now_ns, is_touched)
        if not was_sure:
            self.since_ns = self._debounced.since_ns

    def forget(self) -> None:
        """It has had its effect, or needs none."""
        self.is_sure = False
        self.since_ns = None
        self._debounced.since_ns = None

    def waits_ns(self, now_ns: int) -> int:
        """How long a sure touch has waited; 0 without one."""
        return now_ns - self.since_ns if self.is_sure and self.since_ns is not None else 0


class DriverWins(Property):
    """A touch of wheel, throttle or brake pedal for 50 ms gives the driver the car within 100 ms.

    docs/safety.md, the driver: MANUAL and the relay open (UAH 4.3: at once). While something is
    faulty the 100 ms count from the debounced touch. An emergency brake outranks him.
    """

    name = "the driver wins"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        controls = ("steering wheel", "throttle pedal", "brake pedal")
        self._touches = {control: Touch(settings.debounce_ns) for control in controls}
        self._is_told = False
        self._is_pending = False

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Looks at the three controls while the relay is closed."""
        settings, scene = self.settings, self.scene
        beyond = sample.brake_pedal_ratio - sample.servo_position_ratio
        touched = (
            abs(sample.steering_torque_nm) > settings.driver_torque_nm,
            sample.throttle_pedal_ratio > settings.throttle_pedal_ratio,
            beyond > settings.brake_pedal_ratio,
        )
        if True in touched:
            scene.on_touch(now_ns)
        is_braking = scene.braking_since_ns is not None or sample.is_full_brake_asked
        if not sample.relay_closed or is_braking:
            if self._is_pending:
                for touch in self._touches.values():
                    touch.forget()
            self._is_told = self._is_pending = False
            return
        if not self._is_pending and True not in touched:
            return
        is_disturbed = scene.is_disturbed(now_ns)
        limit_ns = settings.driver_wins_faulty_ns if is_disturbed else settings.driver_wins_ns
        for (control, touch), is_touched in zip(self._touches.items(), touched, strict=True):
            touch.update(now_ns, is_touched)
            waited_ns = touch.waits_ns(now_ns)
            if waited_ns > limit_ns and not self._is_told:
                self._is_told = True
                self.violated(now_ns, f"{control} touched for {ms(waited_ns)}, relay closed")
        self._is_pending = any(touch.since_ns is not None for touch in self._touches.values())


class DriverSteersInEmergency(Property):
    """In an emergency the steering is the driver's at his first touch, and stays his.

    docs/safety.md, the driver; design (driving modes). The motor's outputs open within 100 ms.
    """

    name = "the driver steers in an emergency"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._touch = Touch(settings.debounce_ns)
        self._once = Once()

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Looks at the wheel and at the motor."""
        if self.scene.braking_since_ns is None:
            self._touch.forget()
            self._once.begins(False)
            return
        self._touch.update(now_ns, abs(sample.steering_torque_nm) > self.settings.driver_torque_nm)
        waited_ns = self._touch.waits_ns(now_ns)
        is_due = waited_ns > self.settings.driver_wins_faulty_ns
        if self._once.begins(is_due and sample.steering_motor_powered):
            self.violated(now_ns, f"motor closed {ms(waited_ns)} after he touched the wheel")


class SteeringCoasts(Property):
    """ER4 (motor driver's fault) and ER6 (sensor out of bounds) let the steering coast.

    UWA Table 2, docs/safety.md: the motor's outputs are open as long as one of them is told.
    """

    name = "steering coasts on ER4 and ER6"
    watches = ("STEER_DRIVER", "STEER_EMERGENCY_BRAKE")

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._since_ns: int | None = None
        self._once = Once()

    def on_message(self, now_ns: int, message: Message) -> None:
        """What the steer ECU tells."""
        if not message.is_genuine or not message.values:
            return
        if message.name == "STEER_DRIVER":
            codes = int(message.values["codes"]) | int(message.values["present_codes"])
        else:
            codes = 1 << int(message.values["code"])
            if not codes & ER4_OR_ER6:
                return
        if not codes & ER4_OR_ER6:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = now_ns

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Looks at the motor driver's outputs."""
        since_ns = self._since_ns
        is_due = since_ns is not None and now_ns - since_ns > COAST_NS
        if self._once.begins(is_due and sample.steering_motor_powered):
            self.violated(now_ns, "the motor's outputs are closed")


class RelayOpenUnderDriver(Property):
    """In MANUAL and READY the manual/automatic relay is open.

    UAH 4.3, docs/architecture.md: the relay is what keeps every ECU's hands off.
    """

    name = "relay open under a driver"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._once = Once()
        self._state = scene.channels["SUPERVISOR_STATE"]
        self._closed_ns: int | None = None

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Looks at the relay; the word for a mode comes a little after the relay has moved."""
        if not sample.relay_closed:
            self._closed_ns = None
            self._once.begins(False)
            return
        if self._closed_ns is None:
            self._closed_ns = now_ns
        scene = self.scene
        is_due = now_ns - scene.mode_since_ns > RELAY_NS
        is_still_said = self._state.heard_ns - self._closed_ns > RELAY_NS
        if self._once.begins(scene.mode in HUMAN and is_due and is_still_said):
            self.violated(now_ns, f"closed in {scene.mode.name}")


class NothingMovesUnderDriver(Property):
    """Nothing brakes, steers or drives under a driver: the relay open, only his pedal drives.

    docs/safety.md: nothing ever brakes under a human driver. Servo and steering motor have no
    power, motor torque is what his pedal asks; undisturbed nodes in MANUAL also apply no setpoint.
    """

    name = "nothing moves under a driver"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._open_since_ns: int | None = None
        self._pedal_ratio = 0.0
        self._pedal_ns = 0
        self._once = Once()
        self._echo_once = Once()
        self._echoes = [(scene.channels[name], signal) for name, signal in ECHOES.items()]

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Looks at the actuators while the relay is open, and at the echoes in MANUAL."""
        scene = self.scene
        is_settled = scene.mode is Mode.MANUAL and now_ns - scene.mode_since_ns > SETTLED_NS
        applied = self._applied(now_ns) if is_settled else ""
        if self._echo_once.begins(bool(applied) and not scene.is_disturbed(now_ns)):
            self.violated(now_ns, f"{applied} in MANUAL")
        if sample.relay_closed:
            self._open_since_ns = None
            self._once.begins(False)
            return
        if self._open_since_ns is None:
            self._open_since_ns = now_ns
        pedal_ratio = sample.throttle_pedal_ratio
        if pedal_ratio >= self._pedal_ratio or now_ns - self._pedal_ns > PEDAL_NS:
            self._pedal_ratio, self._pedal_ns = pedal_ratio, now_ns
        open_ns = now_ns - self._open_since_ns
        wrong = self._wrong(sample, open_ns)
        if self._once.begins(bool(wrong)):
            self.violated(now_ns, f"{wrong}, relay open for {ms(open_ns)}")

    def _applied(self, now_ns: int) -> str:
        """A node that says it applies a setpoint, in words."""
        for channel, signal in self._echoes:
            message = channel.newest
            if message is not None and now_ns - channel.newest_ns < channel.timeout_ns:
                applied = message.values[signal]
                if applied == applied:
                    return f"{message.sender} applies {applied:g}"
        return ""

    def _wrong(self, sample: Sample, open_ns: int) -> str:
        """What should not be, in words."""
        if open_ns <= RELAY_NS:
            return ""
        if sample.servo_powered:
            return "the servo has power"
        if sample.steering_motor_powered:
            return "the steering motor has power"
        if open_ns <= RELEASE_NS:
            return ""
        if sample.servo_position_ratio > RELEASED_RATIO:
            return f"the servo is at {sample.servo_position_ratio:.2f}"
        if open_ns <= PEDAL_NS:
            return ""
        torque_nm, slack_nm = sample.motor_torque_nm, self.settings.drive_torque_nm_max
        allowed_nm = self.settings.motor_torque_nm_full * self._pedal_ratio
        if not -slack_nm <= torque_nm <= allowed_nm + slack_nm:
            return f"the motor gives {torque_nm:.1f} N.m"
        return ""
