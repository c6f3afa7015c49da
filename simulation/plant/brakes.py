"""Brakes: the servo that pulls the pedal, the pedal itself and the force it makes."""

from simulation.plant.params import NS_PER_S, BrakeParams, ServoHeatParams


class ServoHeat:
    """The servo's poles: the spring pulls against them as hard as the pedal is pulled."""

    __slots__ = ("_burnt_ratio", "_gain", "heat_ratio", "is_burnt")

    def __init__(self, params: ServoHeatParams, step_ns: int) -> None:
        self._gain = step_ns / NS_PER_S / params.time_constant_s
        self._burnt_ratio = params.burnt_ratio
        self.heat_ratio = 0.0
        self.is_burnt = False

    def step(self, pull_ratio: float) -> None:
        """Integrates one step; the pull is 0 without power."""
        self.heat_ratio += self._gain * (pull_ratio * pull_ratio - self.heat_ratio)
        self.is_burnt = self.is_burnt or self.heat_ratio >= self._burnt_ratio


class Brakes:
    """Servo position at a limited rate; the pedal stands where servo or foot pushes it."""

    __slots__ = (
        "_apply_per_step",
        "_clearance",
        "_dead_band",
        "_force_per_ratio",
        "_return_per_step",
        "heat",
        "pedal_ratio",
        "servo_ratio",
    )

    def __init__(self, params: BrakeParams, step_ns: int) -> None:
        dt_s = step_ns / NS_PER_S
        self._apply_per_step = dt_s / params.servo_travel_s
        self._return_per_step = dt_s / params.servo_return_s
        self._dead_band = params.servo_dead_band_ratio
        self._clearance = params.pad_clearance_ratio
        self._force_per_ratio = params.force_full_n / (1.0 - params.pad_clearance_ratio)
        heat = params.servo_heat
        self.heat = None if heat is None else ServoHeat(heat, step_ns)
        self.servo_ratio = 0.0
        self.pedal_ratio = 0.0

    def step(
        self, target_ratio: float, powered: bool, slow_factor: float, stuck: bool, foot_ratio: float
    ) -> float:
        """Integrates one step.

        Args:
            target_ratio: The servo's setpoint, 0..1.
            powered: Without power the spring takes the servo back.
            slow_factor: The powered servo needs this many times its normal travel time.
            stuck: The servo does not move.
            foot_ratio: The driver's foot, 0..1.

        Returns:
            Brake force of the whole car, newtons, before the tyres' limits.
        """
        servo = self.servo_ratio
        heat = self.heat
        if heat is not None:
            powered = powered and not heat.is_burnt
            heat.step(servo if powered else 0.0)
        if not stuck:
            if powered:
                error = target_ratio - servo
                # a servo rests within its dead band, but its ends it reaches
                if abs(error) > self._dead_band or not 0.0 < target_ratio < 1.0:
                    limit = self._apply_per_step / slow_factor
                    if error > limit:
                        error = limit
                    elif error < -limit:
                        error = -limit
                    servo += error
            else:
                servo -= self._return_per_step
                if servo < 0.0:
                    servo = 0.0
            self.servo_ratio = servo
        pedal = servo if servo > foot_ratio else foot_ratio
        self.pedal_ratio = pedal
        travel = pedal - self._clearance
        return travel * self._force_per_ratio if travel > 0.0 else 0.0
