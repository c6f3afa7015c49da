"""Steering column: EPS motor, friction, aligning torque, end stops, and the way to the wheels."""

from simulation.plant.linkage import Linkage
from simulation.plant.params import NS_PER_S, PlantParams


class SteeringColumn:
    """One rotating mass, moved by motor, driver and tyres; angles positive to the left.

    The motor is fed with a voltage, so that its back-EMF brakes it while the driver's outputs
    are closed, even at zero duty, and does not while they are open.
    """

    __slots__ = (
        "_coulomb_nm",
        "_damping_closed",
        "_damping_open",
        "_delay_index",
        "_delay_length",
        "_delayed_duty",
        "_dt_s",
        "_filter_gain",
        "_friction_slope",
        "_inverse_inertia",
        "_inverse_ratio",
        "_linkage",
        "_scrub_nm",
        "_scrub_speed_mps",
        "_stall_nm",
        "_stop_rad",
        "accel_filtered_radps2",
        "angle_rad",
        "rate_radps",
        "road_wheel_rad",
    )

    def __init__(self, car: PlantParams) -> None:
        params = car.steering
        self._dt_s = dt_s = car.step_ns / NS_PER_S
        self._inverse_inertia = 1.0 / (params.column_inertia_kgm2 + params.hand_wheel_inertia_kgm2)
        self._stall_nm = params.motor_stall_torque_nm
        back_emf = params.motor_stall_torque_nm / params.motor_no_load_speed_radps
        per_step = dt_s * self._inverse_inertia
        self._damping_closed = 1.0 + per_step * (params.viscous_nm_per_radps + back_emf)
        self._damping_open = 1.0 + per_step * params.viscous_nm_per_radps
        self._coulomb_nm = params.coulomb_torque_nm
        self._scrub_nm = params.scrub_torque_nm
        self._scrub_speed_mps = params.scrub_speed_mps
        self._friction_slope = params.scrub_torque_nm / params.scrub_speed_mps
        self._stop_rad = params.end_stop_rad
        self._filter_gain = dt_s / (dt_s + car.sensors.torque_filter_s)
        self._delay_length = max(1, round(params.dead_time_ns / car.step_ns))
        self._delayed_duty = [0.0] * self._delay_length
        self._delay_index = 0
        self.angle_rad = 0.0
        self.rate_radps = 0.0
        self.accel_filtered_radps2 = 0.0
        self._inverse_ratio = 1.0 / params.column_to_road_wheel_ratio
        self._linkage = None if car.linkage is None else Linkage(car.linkage)
        self.road_wheel_rad = 0.0

    def step(
        self,
        duty: float,
        powered: bool,
        driver_torque_nm: float,
        aligning_torque_nm: float,
        speed_mps: float,
    ) -> None:
        """Integrates one step; the duty acts after the dead time, an open output at once.

        Args:
            duty: -1..1, what the driver's input holds now.
            powered: The motor driver's outputs are closed.
            driver_torque_nm: On the hand wheel.
            aligning_torque_nm: Of the tyres, at the column, as a torque that acts on it.
            speed_mps: Of the car; a standing tyre scrubs.
        """
        line = self._delayed_duty
        index = self._delay_index
        delayed_duty = line[index]
        line[index] = duty if powered else 0.0
        index += 1
        self._delay_index = index if index < self._delay_length else 0

        dt_s = self._dt_s
        torque_nm = driver_torque_nm + aligning_torque_nm
        if powered:
            torque_nm += self._stall_nm * delayed_duty
            damping = self._damping_closed
        else:
            damping = self._damping_open
        friction_nm = self._coulomb_nm
        if -self._scrub_speed_mps < speed_mps < self._scrub_speed_mps:
            friction_nm += self._scrub_nm - self._friction_slope * abs(speed_mps)

        gain = dt_s * self._inverse_inertia
        rate_old = self.rate_radps
        # dry friction takes away at most the speed there is; damping is implicit: never unstable
        rate = rate_old + gain * torque_nm
        friction = gain * friction_nm
        if rate > friction:
            rate = (rate - friction) / damping
        elif rate < -friction:
            rate = (rate + friction) / damping
        else:
            rate = 0.0
        angle = self.angle_rad + 0.5 * dt_s * (rate_old + rate)
        stop_rad = self._stop_rad
        if angle > stop_rad:
            angle = stop_rad
            rate = min(rate, 0.0)
        elif angle < -stop_rad:
            angle = -stop_rad
            rate = max(rate, 0.0)
        self.angle_rad = angle
        self.rate_radps = rate
        filtered = self.accel_filtered_radps2
        self.accel_filtered_radps2 = filtered + self._filter_gain * (
            (rate - rate_old) / dt_s - filtered
        )
        self._turn_road_wheels()

    def _turn_road_wheels(self) -> None:
        tight_rad = self.angle_rad * self._inverse_ratio
        linkage = self._linkage
        self.road_wheel_rad = tight_rad if linkage is None else linkage.follow(tight_rad)
