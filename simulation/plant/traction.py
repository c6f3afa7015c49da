"""Traction: the drive's two analogue inputs, the asynchronous motor and the gearbox."""

from simulation.plant.params import NS_PER_S, TractionParams


class DriveInput:
    """One analogue input of the drive: from voltage or DAC code to a share of its torque."""

    __slots__ = ("_dac_steps", "_low_v", "_per_volt", "_volt_per_code", "idle_v", "span_v")

    def __init__(self, params: TractionParams) -> None:
        self.idle_v = params.signal_idle_v
        self.span_v = params.signal_full_v - params.signal_idle_v
        self._low_v = params.signal_idle_v + params.signal_threshold_v
        self._per_volt = 1.0 / (self.span_v - 2.0 * params.signal_threshold_v)
        self._volt_per_code = params.dac_reference_v / params.dac_steps
        self._dac_steps = params.dac_steps

    def ratio_of_voltage(self, voltage_v: float) -> float:
        """0 at idle and below .. 1 at full and above."""
        return min(1.0, max(0.0, (voltage_v - self._low_v) * self._per_volt))

    def ratio_of_code(self, code: int) -> float:
        """The same for what the 12-bit DAC puts out; a code it does not have is a bug."""
        assert 0 <= code < self._dac_steps, f"DAC code {code}"
        return self.ratio_of_voltage(code * self._volt_per_code)

    def ratio_of_pedal(self, pedal_ratio: float) -> float:
        """The same for the driver's pedal, whose voltage spans idle to full."""
        return self.ratio_of_voltage(self.idle_v + self.span_v * pedal_ratio)


class Traction:
    """Motor torque after dead time and lag, within torque, power and speed limits.

    Attributes:
        torque_nm: Of the motor; negative when it regenerates.
        drive_nm: What it would be without regeneration, whichever way it turns.
        is_reverse: The reverse contact is closed: drive torque turns backwards.
    """

    __slots__ = (
        "_delay_index",
        "_delay_length",
        "_delayed_drive",
        "_delayed_regen",
        "_drive_ratio",
        "_fade_per_mps",
        "_force_per_nm_driving",
        "_force_per_nm_regenerating",
        "_lag_gain",
        "_motor_radps_per_mps",
        "_power_w",
        "_regen_nm",
        "_regen_ratio",
        "_speed_radps_max",
        "_torque_nm",
        "drive_nm",
        "is_reverse",
        "torque_nm",
    )

    def __init__(self, params: TractionParams, step_ns: int, wheel_radius_m: float) -> None:
        dt_s = step_ns / NS_PER_S
        self._torque_nm = params.motor_torque_nm_max
        self._power_w = params.motor_power_w_max
        self._speed_radps_max = params.motor_speed_radps_max
        self._regen_nm = params.regen_torque_nm_max
        self._fade_per_mps = 1.0 / params.regen_fade_speed_mps
        gear_per_m = params.gear_ratio / wheel_radius_m
        self._motor_radps_per_mps = gear_per_m
        # losses take from the wheels what the motor gives, and from the battery what they give
        self._force_per_nm_driving = gear_per_m * params.gear_efficiency_ratio
        self._force_per_nm_regenerating = gear_per_m / params.gear_efficiency_ratio
        self._lag_gain = dt_s / (dt_s + params.torque_lag_s)
        self._delay_length = max(1, round(params.dead_time_ns / step_ns))
        self._delayed_drive = [0.0] * self._delay_length
        self._delayed_regen = [0.0] * self._delay_length
        self._delay_index = 0
        self._drive_ratio = 0.0
        self._regen_ratio = 0.0
        self.is_reverse = False
        self.drive_nm = 0.0
        self.torque_nm = 0.0

    def step(
        self, drive_ratio: float, regen_ratio: float, dead: bool, wheel_speed_mps: float
    ) -> float:
        """Integrates one step.

        Args:
            drive_ratio: At the throttle input, 0..1.
            regen_ratio: At the regeneration input, 0..1.
            dead: The motor gives no torque.
            wheel_speed_mps: Of the front wheels' circumference, signed.

        Returns:
            Force at the front wheels, newtons, positive forwards.
        """
        index = self._delay_index
        drive_line = self._delayed_drive
        regen_line = self._delayed_regen
        gain = self._lag_gain
        # the lag lies on the request, so that regeneration never outlives the car's movement
        drive = self._drive_ratio
        drive += gain * (drive_line[index] - drive)
        self._drive_ratio = drive
        regen = self._regen_ratio
        regen += gain * (regen_line[index] - regen)
        self._regen_ratio = regen
        drive_line[index] = drive_ratio
        regen_line[index] = regen_ratio
        index += 1
        self._delay_index = index if index < self._delay_length else 0
        if dead:
            self.drive_nm = self.torque_nm = 0.0
            return 0.0

        motor_radps = abs(wheel_speed_mps) * self._motor_radps_per_mps
        limit_nm = self._torque_nm
        if motor_radps * limit_nm > self._power_w:
            limit_nm = self._power_w / motor_radps
        drive_nm = drive * limit_nm if motor_radps < self._speed_radps_max else 0.0
        fade = wheel_speed_mps * self._fade_per_mps
        if fade > 1.0:
            fade = 1.0
        elif fade < -1.0:
            fade = -1.0
        self.drive_nm = drive_nm
        if self.is_reverse:
            drive_nm = -drive_nm
        torque_nm = drive_nm - regen * min(self._regen_nm, limit_nm) * fade
        self.torque_nm = torque_nm
        if torque_nm * wheel_speed_mps >= 0.0:
            return torque_nm * self._force_per_nm_driving
        return torque_nm * self._force_per_nm_regenerating
