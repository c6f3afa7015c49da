"""Body and tyres: a bicycle model that also stands still, holds a slope and slides.

The state lies at the centre of gravity, what is reported at the rear-axle centre. Below walking
pace the wheels roll without side slip (kinematic model); above it lateral tyre forces grow with
slip and saturate at what the friction circle leaves. Braking and rolling resistance act as dry
friction: they take away speed and never add any.
"""

from math import cos, sin, sqrt
from typing import Final

from simulation.plant.params import AIR_DENSITY_KG_PER_M3, GRAVITY_MPS2, NS_PER_S, PlantParams

# Tyres keep a fifth of their lateral force when they brake or drive at their limit
# (sqrt(1 - 0.98^2) = 0.2); assumption, it keeps a sliding car steerable a little.
LONGITUDINAL_USE_MAX: Final = 0.98
BLEND_TIME_S: Final = 0.05  # how fast the kinematic model takes over; assumption, numerics only
UNLOCK_TIME_S: Final = 0.05  # a wheel released by its brake is back at speed; assumption


class Chassis:
    """Planar motion under drive force, brake force and road-wheel angle.

    A car that is driven at the rear has its force in `rear_drive_n` before each step.
    """

    __slots__ = (
        "_axle_lock_gain",
        "_blend_per_mps",
        "_brake_front_share",
        "_cg_to_front_m",
        "_cg_to_rear_m",
        "_cornering_front",
        "_cornering_rear",
        "_drag_n_per_mps2",
        "_dt_s",
        "_grade_n",
        "_inverse_slip_stiffness",
        "_inverse_wheelbase",
        "_inverse_yaw_inertia",
        "_kinematic_mps",
        "_load_front_n",
        "_load_rear_n",
        "_load_shift_kg",
        "_mass_effective_kg",
        "_mass_front_kg",
        "_mass_kg",
        "_mu",
        "_params",
        "_rolling_n",
        "_rolling_ratio",
        "_unlock_per_step",
        "_weight_n",
        "_yaw_inertia",
        "accel_lateral_mps2",
        "accel_longitudinal_mps2",
        "distance_m",
        "front_axle_force_lateral_n",
        "front_lock_ratio",
        "front_wheel_speed_mps",
        "heading_rad",
        "lateral_speed_mps",
        "rear_drive_n",
        "rear_lock_ratio",
        "speed_mps",
        "x_m",
        "y_m",
        "yaw_rate_radps",
    )

    def __init__(self, params: PlantParams) -> None:
        chassis = params.chassis
        front_share = chassis.front_load_share_ratio
        wheelbase_m = chassis.wheelbase_m
        self._params = params
        self._dt_s = params.step_ns / NS_PER_S
        self._set_mass(params.mass_kg)
        self._cg_to_front_m = wheelbase_m * (1.0 - front_share)
        self._cg_to_rear_m = wheelbase_m * front_share
        self._inverse_wheelbase = 1.0 / wheelbase_m
        self._cornering_front = chassis.front_cornering_stiffness_n_per_rad
        self._cornering_rear = chassis.rear_cornering_stiffness_n_per_rad
        self._inverse_slip_stiffness = 1.0 / chassis.longitudinal_slip_stiffness_n
        self._drag_n_per_mps2 = 0.5 * AIR_DENSITY_KG_PER_M3 * chassis.drag_area_m2
        self._rolling_ratio = chassis.rolling_resistance_ratio
        self._brake_front_share = params.brakes.front_share_ratio
        self._kinematic_mps = chassis.kinematic_speed_mps
        self._blend_per_mps = 1.0 / (chassis.dynamic_speed_mps - chassis.kinematic_speed_mps)
        self._axle_lock_gain = self._dt_s * chassis.wheel_radius_m**2 / chassis.axle_inertia_kgm2
        self._unlock_per_step = self._dt_s / UNLOCK_TIME_S
        self.x_m = self.y_m = self.heading_rad = 0.0
        self.speed_mps = self.lateral_speed_mps = self.yaw_rate_radps = 0.0
        self.accel_longitudinal_mps2 = self.accel_lateral_mps2 = 0.0
        self.front_wheel_speed_mps = 0.0
        self.front_axle_force_lateral_n = 0.0
        self.front_lock_ratio = self.rear_lock_ratio = 0.0
        self.rear_drive_n = 0.0
        self.distance_m = 0.0
        self.set_road(chassis.friction_mu, chassis.slope_rad)

    def _set_mass(self, mass_kg: float) -> None:
        """Everything that follows from the mass; its centre stays where it is."""
        chassis = self._params.chassis
        self._mass_kg = mass_kg
        self._mass_front_kg = mass_kg * chassis.front_load_share_ratio
        self._mass_effective_kg = (
            mass_kg + chassis.rotating_inertia_kgm2 / chassis.wheel_radius_m**2
        )
        self._yaw_inertia = mass_kg * chassis.yaw_radius_of_gyration_m**2
        self._inverse_yaw_inertia = 1.0 / self._yaw_inertia
        self._load_shift_kg = mass_kg * chassis.centre_height_m / chassis.wheelbase_m

    def set_road(self, friction_mu: float, slope_rad: float, load_kg: float = 0.0) -> None:
        """Puts the car on a road with this friction and slope (positive uphill), loaded so."""
        assert 0.0 < friction_mu <= 2.0 and abs(slope_rad) < 1.0, (friction_mu, slope_rad)
        assert load_kg >= 0.0, load_kg
        self._set_mass(self._params.mass_kg + load_kg)
        self._mu = friction_mu
        self._weight_n = self._mass_kg * GRAVITY_MPS2 * cos(slope_rad)
        self._grade_n = self._mass_kg * GRAVITY_MPS2 * sin(slope_rad)
        self._load_front_n = self._weight_n * self._cg_to_rear_m * self._inverse_wheelbase
        self._load_rear_n = self._weight_n - self._load_front_n
        self._rolling_n = self._rolling_ratio * self._weight_n

    @property
    def rear_lateral_speed_mps(self) -> float:
        """Side slip of the rear axle, positive to the left."""
        return self.lateral_speed_mps - self._cg_to_rear_m * self.yaw_rate_radps

    def kinetic_energy_j(self) -> float:
        """Of the body's motion and of what rotates with the wheels."""
        return 0.5 * (
            self._mass_effective_kg * self.speed_mps**2
            + self._mass_kg * self.lateral_speed_mps**2
            + self._yaw_inertia * self.yaw_rate_radps**2
        )

    def step(self, wheel_angle_rad: float, drive_n: float, brake_n: float) -> None:
        """Integrates one step.

        Args:
            wheel_angle_rad: Of the imaginary wheel in the middle of the front axle.
            drive_n: At the front wheels, signed.
            brake_n: Of all wheels together, not negative.
        """
        speed = self.speed_mps
        lateral = self.lateral_speed_mps
        yaw_rate = self.yaw_rate_radps
        sin_angle = sin(wheel_angle_rad)
        cos_angle = cos(wheel_angle_rad)
        shift_n = self._load_shift_kg * self.accel_longitudinal_mps2
        grip_front_n = self._mu * (self._load_front_n - shift_n)
        grip_rear_n = self._mu * (self._load_rear_n + shift_n)
        drive_n, brake_front_n, brake_rear_n = self._tyre_limited(
            drive_n, brake_n, grip_front_n, grip_rear_n
        )
        force_front_n = drive_n - brake_front_n if speed >= 0.0 else drive_n + brake_front_n
        drive_rear_n = self.rear_drive_n
        if drive_rear_n != 0.0:  # what the tyres transmit of it besides the brake
            cap_n = LONGITUDINAL_USE_MAX * grip_rear_n
            drive_rear_n = max(brake_rear_n - cap_n, min(brake_rear_n + cap_n, drive_rear_n))

        # no side slip below walking pace, where the wheels only roll
        weight = (speed - self._kinematic_mps) * self._blend_per_mps
        if weight > 0.0:
            if weight > 1.0:
                weight = 1.0
            # slip angles in each wheel's own direction, forces within the friction circle
            lateral_front = lateral + self._cg_to_front_m * yaw_rate
            side_n = (
                self._cornering_front
                * (speed * sin_angle - lateral_front * cos_angle)
                / (speed * cos_angle + lateral_front * sin_angle)
            )
            room = grip_front_n * grip_front_n - force_front_n * force_front_n
            side_front_n = side_n / sqrt(1.0 + side_n * side_n / room)
            side_n = self._cornering_rear * (self._cg_to_rear_m * yaw_rate - lateral) / speed
            force_rear_n = drive_rear_n - brake_rear_n
            room = grip_rear_n * grip_rear_n - force_rear_n * force_rear_n
            side_rear_n = side_n / sqrt(1.0 + side_n * side_n / room)
            pull_n = weight * (self._mass_kg * lateral * yaw_rate - side_front_n * sin_angle)
        else:
            weight = side_front_n = side_rear_n = pull_n = 0.0

        new_speed = self._rolled(
            speed,
            drive_n * cos_angle + pull_n + drive_rear_n,
            brake_front_n * cos_angle + brake_rear_n,
        )
        self.speed_mps = new_speed
        rolling_yaw_rate = new_speed * self._inverse_wheelbase * sin_angle / cos_angle
        if weight > 0.0:
            turn_n = side_front_n * cos_angle + force_front_n * sin_angle
            self._slide(turn_n, side_rear_n, speed, rolling_yaw_rate, weight)
        else:
            self.lateral_speed_mps = self._cg_to_rear_m * rolling_yaw_rate
            self.yaw_rate_radps = rolling_yaw_rate
        self.front_axle_force_lateral_n = (
            weight * side_front_n + (1.0 - weight) * self._mass_front_kg * speed * yaw_rate
        )
        lateral_front = self.lateral_speed_mps + self._cg_to_front_m * self.yaw_rate_radps
        self.front_wheel_speed_mps = (
            (new_speed * cos_angle + lateral_front * sin_angle)
            * (1.0 + force_front_n * self._inverse_slip_stiffness)
            * (1.0 - self.front_lock_ratio)
        )
        self._move(speed, lateral, yaw_rate)

    def _tyre_limited(
        self, drive_n: float, brake_n: float, grip_front_n: float, grip_rear_n: float
    ) -> tuple[float, float, float]:
        """Drive force and both axles' brake forces as far as the tyres transmit them."""
        cap_front_n = LONGITUDINAL_USE_MAX * grip_front_n
        if drive_n > cap_front_n:
            drive_n = cap_front_n
        elif drive_n < -cap_front_n:
            drive_n = -cap_front_n
        if brake_n == 0.0:
            if self.front_lock_ratio or self.rear_lock_ratio:
                self._lock_wheels(0.0, 0.0)
            return drive_n, 0.0, 0.0
        front_n = brake_n * self._brake_front_share
        rear_n = brake_n - front_n
        room_front_n = cap_front_n + drive_n if drive_n < 0.0 else cap_front_n
        room_rear_n = LONGITUDINAL_USE_MAX * grip_rear_n
        self._lock_wheels(front_n - room_front_n, rear_n - room_rear_n)
        return drive_n, min(front_n, room_front_n), min(rear_n, room_rear_n)

    def _rolled(self, speed: float, push_n: float, brake_n: float) -> float:
        """Speed after one step: driving forces first, then dry friction up to a standstill."""
        gain = self._dt_s / self._mass_effective_kg
        push_n -= self._grade_n + self._drag_n_per_mps2 * speed * abs(speed)
        new_speed = speed + gain * push_n
        loss = gain * (brake_n + self._rolling_n)
        if new_speed > loss:
            return new_speed - loss
        if new_speed < -loss:
            return new_speed + loss
        return 0.0

    def _slide(
        self,
        turn_n: float,
        side_rear_n: float,
        speed: float,
        rolling_yaw_rate: float,
        weight: float,
    ) -> None:
        """Lateral motion and yaw under tyre forces, drawn to rolling at walking pace."""
        dt_s = self._dt_s
        lateral = self.lateral_speed_mps
        yaw_rate = self.yaw_rate_radps
        cg_to_rear_m = self._cg_to_rear_m
        new_lateral = lateral + dt_s * ((turn_n + side_rear_n) / self._mass_kg - speed * yaw_rate)
        new_yaw_rate = yaw_rate + dt_s * self._inverse_yaw_inertia * (
            self._cg_to_front_m * turn_n - cg_to_rear_m * side_rear_n
        )
        if weight < 1.0:
            pace = dt_s * (1.0 - weight) / (weight * BLEND_TIME_S)
            pace /= 1.0 + pace
            new_lateral += pace * (cg_to_rear_m * rolling_yaw_rate - new_lateral)
            new_yaw_rate += pace * (rolling_yaw_rate - new_yaw_rate)
        self.lateral_speed_mps = new_lateral
        self.yaw_rate_radps = new_yaw_rate

    def _move(self, speed: float, lateral: float, yaw_rate: float) -> None:
        """Moves the rear-axle centre with the mean of old and new velocities."""
        dt_s = self._dt_s
        new_speed = self.speed_mps
        new_yaw_rate = self.yaw_rate_radps
        self.accel_longitudinal_mps2 = (new_speed - speed) / dt_s - lateral * yaw_rate
        self.accel_lateral_mps2 = (self.lateral_speed_mps - lateral) / dt_s + speed * yaw_rate
        ahead_m = 0.5 * dt_s * (speed + new_speed)
        if ahead_m == 0.0:
            return
        turn_rad = 0.5 * dt_s * (yaw_rate + new_yaw_rate)
        left_m = 0.5 * dt_s * (lateral + self.lateral_speed_mps) - self._cg_to_rear_m * turn_rad
        heading = self.heading_rad + 0.5 * turn_rad
        sin_heading = sin(heading)
        cos_heading = cos(heading)
        self.x_m += ahead_m * cos_heading - left_m * sin_heading
        self.y_m += ahead_m * sin_heading + left_m * cos_heading
        self.heading_rad += turn_rad
        self.distance_m += abs(ahead_m)

    def _lock_wheels(self, excess_front_n: float, excess_rear_n: float) -> None:
        """Slows an axle's wheels whose brake is stronger than their tyres; 1 = locked."""
        speed = abs(self.speed_mps)
        if excess_front_n > 0.0 and speed > 0.0:
            lock = self.front_lock_ratio + self._axle_lock_gain * excess_front_n / speed
            self.front_lock_ratio = min(1.0, lock)
        elif self.front_lock_ratio > 0.0:
            self.front_lock_ratio = max(0.0, self.front_lock_ratio - self._unlock_per_step)
        if excess_rear_n > 0.0 and speed > 0.0:
            lock = self.rear_lock_ratio + self._axle_lock_gain * excess_rear_n / speed
            self.rear_lock_ratio = min(1.0, lock)
        elif self.rear_lock_ratio > 0.0:
            self.rear_lock_ratio = max(0.0, self.rear_lock_ratio - self._unlock_per_step)
