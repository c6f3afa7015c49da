"""The car: every part of the plant, integrated together in virtual time.

Steps lie on a fixed grid that starts at power-on. A call at some instant integrates up to the
first grid point at or after it; a command then acts from that point on, at most one step late.
Readings and poses are those of the instant itself, interpolated within the step.

Times are the simulation's true time: a caller whose own clock drifts converts first.
"""

from math import cos, pi, sin
from typing import Final, NamedTuple

from numpy.random import Generator

from ecus.brake_servo.ports import BrakeActuator, BrakeSensors
from ecus.steering.ports import SteeringActuator, SteeringSensors
from ecus.supervisor.ports import SupervisorActuator, SupervisorSensors
from ecus.throttle.ports import ThrottleActuator, ThrottleSensors
from simulation.plant.brakes import Brakes
from simulation.plant.chassis import Chassis
from simulation.plant.circuits import SafetyCircuits
from simulation.plant.drive_train import DriveTrain
from simulation.plant.hardware import Hardware
from simulation.plant.params import GRAVITY_MPS2, NS_PER_S, PlantParams
from simulation.plant.sensors import Encoder, NoiseSource, quantise_ratio
from simulation.plant.state import DriverInputs, PlantFaults, Pose, Truth
from simulation.plant.steering import SteeringColumn
from simulation.plant.traction import Traction

ORIGIN: Final = Pose(x_m=0.0, y_m=0.0, heading_rad=0.0)


class Parts(NamedTuple):
    """What the car is made of."""

    chassis: Chassis
    column: SteeringColumn
    brakes: Brakes
    traction: Traction
    hardware: Hardware


class Car:
    """One car in virtual time, with its actuators, sensors and safety circuits.

    Attributes:
        params: What the car is.
        driver: What the human does; write to it at any time.
        faults: What is broken; write to it at any time.
        train: Its motor drives on the bus, if it has any.
    """

    __slots__ = (
        "_aligning_per_n",
        "_brake_noise",
        "_brakes",
        "_chassis",
        "_circuits",
        "_column",
        "_column_reading_rad",
        "_end_ns",
        "_hand_wheel_inertia",
        "_hardware",
        "_motor_encoder",
        "_now_ns",
        "_road",
        "_slope_noise",
        "_steering_noise",
        "_step_ns",
        "_throttle_noise",
        "_traction",
        "_wheel_encoder",
        "_wheel_offset_left_m",
        "driver",
        "faults",
        "params",
        "train",
    )

    def __init__(
        self,
        params: PlantParams,
        rng: Generator,
        start_pose: Pose = ORIGIN,
        start_ns: int = 0,
    ) -> None:
        """Parks a car.

        Args:
            params: Of this car.
            rng: Seeded; each ECU's sensors get a stream of their own from it.
            start_pose: Where the rear-axle centre stands.
            start_ns: Virtual time of power-on.
        """
        self.params = params
        self.driver = DriverInputs()
        self.faults = PlantFaults()
        step_ns = params.step_ns
        sensors = params.sensors
        radius_m = params.chassis.wheel_radius_m
        self._step_ns = step_ns
        self._now_ns = self._end_ns = start_ns
        self._column = SteeringColumn(params)
        self._traction = Traction(params.traction, step_ns, radius_m)
        self._brakes = Brakes(params.brakes, step_ns)
        self._chassis = Chassis(params)
        self._chassis.x_m = start_pose.x_m
        self._chassis.y_m = start_pose.y_m
        self._chassis.heading_rad = start_pose.heading_rad
        self._hardware = Hardware(params, start_ns)
        circuits = params.hardware.circuits
        self._circuits = None if circuits is None else SafetyCircuits(circuits)
        self.train: DriveTrain | None = None
        if params.drives is not None:
            self.train = DriveTrain(params, params.drives, self._chassis, start_ns)
            self._column = self.train.column
            self._traction = self.train.traction
            self._hardware = self.train.hardware
        wheel_turns_per_m = 1.0 / (2.0 * pi * radius_m)
        motor_edges_per_m = (
            sensors.motor_pulses_per_rev * params.traction.gear_ratio * wheel_turns_per_m
        )
        timer_ns = sensors.encoder_timer_ns
        age_ns_max = sensors.edge_age_ns_max
        self._motor_encoder = Encoder(motor_edges_per_m, step_ns, timer_ns, age_ns_max, start_ns)
        wheel_edges_per_m = sensors.wheel_pulses_per_rev * wheel_turns_per_m
        self._wheel_encoder = Encoder(wheel_edges_per_m, step_ns, timer_ns, age_ns_max, start_ns)
        self._wheel_offset_left_m = sensors.wheel_encoder_offset_left_m
        steering = params.steering
        self._aligning_per_n = -steering.trail_m / steering.column_to_road_wheel_ratio
        self._hand_wheel_inertia = steering.hand_wheel_inertia_kgm2
        self._column_reading_rad = sensors.column_angle_zero_rad
        self._road = (params.chassis.friction_mu, params.chassis.slope_rad, 0.0)
        streams = rng.spawn(4)
        self._steering_noise = NoiseSource(streams[0])
        self._throttle_noise = NoiseSource(streams[1])
        self._brake_noise = NoiseSource(streams[2])
        self._slope_noise = NoiseSource(streams[3])

    def advance(self, now_ns: int) -> None:
        """Integrates up to this time; asking for the present again does nothing.

        Args:
            now_ns: Absolute virtual time, never before that of an earlier call.
        """
        assert now_ns >= self._now_ns, f"time runs back from {self._now_ns} to {now_ns} ns"
        self._now_ns = now_ns
        if now_ns > self._end_ns:
            self._integrate(now_ns)

    def actuate_steering(self, now_ns: int, command: SteeringActuator) -> None:
        """Sets the steering motor's driver and feeds its watchdog."""
        self.advance(now_ns)
        self._hardware.refresh_steering(now_ns, command)

    def actuate_throttle(self, now_ns: int, command: ThrottleActuator) -> None:
        """Sets both DACs of the traction drive and feeds their watchdog."""
        self.advance(now_ns)
        self._hardware.refresh_throttle(now_ns, command)

    def actuate_brake(self, now_ns: int, command: BrakeActuator) -> None:
        """Sets the brake servo and feeds its watchdog."""
        self.advance(now_ns)
        self._hardware.refresh_brake(now_ns, command)

    def actuate_supervisor(self, now_ns: int, command: SupervisorActuator) -> None:
        """Moves the manual/automatic relay, or leaves it."""
        self.advance(now_ns)
        self._hardware.switch_relay(now_ns, command, self.faults.relay_stuck)

    def sense_steering(self, now_ns: int) -> SteeringSensors:
        """Reads column angle, torque sensor and the motor driver's fault line.

        The torque sensor sits between hand wheel and motor input. It carries what the driver
        gives less what the hand wheel's own inertia takes: with no hands on the wheel it reads
        -J * acceleration.
        """
        self.advance(now_ns)
        faults = self.faults
        sensors = self.params.sensors
        draw = self._steering_noise.draw
        angle_noise = draw()
        torque_noise = draw()
        angle_rad = faults.steering_angle_override_rad
        if angle_rad is None:
            if not faults.steering_angle_stuck:
                column = self._column
                before_end_s = (self._end_ns - now_ns) / NS_PER_S
                angle_rad = (
                    column.angle_rad
                    - column.rate_radps * before_end_s
                    + sensors.column_angle_zero_rad
                    + sensors.column_angle_noise_rad * angle_noise
                )
                resolution_rad = sensors.column_angle_step_rad
                self._column_reading_rad = round(angle_rad / resolution_rad) * resolution_rad
            angle_rad = self._column_reading_rad
        torque_nm = faults.steering_torque_override_nm
        if torque_nm is None:
            torque_nm = (
                self.driver.steering_torque_nm
                - self._hand_wheel_inertia * self._column.accel_filtered_radps2
                + sensors.torque_zero_nm
                + sensors.torque_noise_nm * torque_noise
            )
            torque_nm = min(sensors.torque_nm_max, max(-sensors.torque_nm_max, torque_nm))
        return SteeringSensors(
            column_angle_rad=angle_rad,
            driver_torque_nm=torque_nm,
            motor_fault=faults.steering_motor_fault,
        )

    def sense_throttle(self, now_ns: int) -> ThrottleSensors:
        """Reads the traction motor's encoder and the throttle pedal."""
        self.advance(now_ns)
        faults = self.faults
        sensors = self.params.sensors
        noise = sensors.pedal_noise_ratio * self._throttle_noise.draw()
        count, age_s = self._motor_encoder.read(now_ns, faults.motor_encoder_dead)
        pedal_ratio = faults.throttle_pedal_override_ratio
        if pedal_ratio is None:
            pedal_ratio = quantise_ratio(
                self.driver.throttle_pedal_ratio + noise, sensors.throttle_pedal_steps
            )
        return ThrottleSensors(
            encoder_count=count, encoder_edge_age_s=age_s, pedal_ratio=pedal_ratio
        )

    def sense_brake(self, now_ns: int) -> BrakeSensors:
        """Reads servo, brake pedal (which the servo moves too), a rear wheel and inclinometer."""
        self.advance(now_ns)
        faults = self.faults
        sensors = self.params.sensors
        draw = self._brake_noise.draw
        servo_noise = sensors.servo_noise_ratio * draw()
        pedal_noise = sensors.pedal_noise_ratio * draw()
        servo_ratio = faults.servo_position_override_ratio
        if servo_ratio is None:
            servo_ratio = quantise_ratio(
                self._brakes.servo_ratio + servo_noise, sensors.servo_steps
            )
        pedal_ratio = faults.brake_pedal_override_ratio
        if pedal_ratio is None:
            pedal_ratio = quantise_ratio(
                self._brakes.pedal_ratio + pedal_noise, sensors.brake_pedal_steps
            )
        count, age_s = self._wheel_encoder.read(now_ns, faults.wheel_encoder_dead)
        return BrakeSensors(
            servo_position_ratio=servo_ratio,
            pedal_ratio=pedal_ratio,
            wheel_count=count,
            wheel_edge_age_s=age_s,
            slope_rad=(
                self._road[1]
                + self._chassis.accel_longitudinal_mps2 / GRAVITY_MPS2
                + sensors.slope_zero_rad
                + sensors.slope_noise_rad * self._slope_noise.draw()
            ),
        )

    def sense_supervisor(self, now_ns: int) -> SupervisorSensors:
        """Reads the panel's button, the emergency-stop line and the relay's contact."""
        self.advance(now_ns)
        return SupervisorSensors(
            button_pressed=self.driver.button_pressed,
            emergency_stop_pressed=self.emergency_line,
            automatic_relay_closed=self._hardware.relay_closed,
        )

    @property
    def emergency_line(self) -> bool:
        """The emergency-stop line: the button, or a safety circuit where the car has them."""
        circuits = self._circuits
        raised = circuits is not None and circuits.is_raised(self._now_ns)
        return self.driver.emergency_stop_pressed or raised

    @property
    def pose(self) -> Pose:
        """Rear-axle centre at the time of the latest call."""
        chassis = self._chassis
        before_end_s = (self._end_ns - self._now_ns) / NS_PER_S
        heading = chassis.heading_rad - chassis.yaw_rate_radps * before_end_s
        ahead_m = chassis.speed_mps * before_end_s
        left_m = chassis.rear_lateral_speed_mps * before_end_s
        return Pose(
            x_m=chassis.x_m - ahead_m * cos(heading) + left_m * sin(heading),
            y_m=chassis.y_m - ahead_m * sin(heading) - left_m * cos(heading),
            heading_rad=heading,
        )

    @property
    def truth(self) -> Truth:
        """The car at the time of the latest call; speeds and forces of that call's step."""
        chassis = self._chassis
        column = self._column
        return Truth(
            time_ns=self._now_ns,
            pose=self.pose,
            speed_mps=chassis.speed_mps,
            yaw_rate_radps=chassis.yaw_rate_radps,
            column_angle_rad=column.angle_rad,
            column_rate_radps=column.rate_radps,
            road_wheel_angle_rad=column.road_wheel_rad,
            servo_position_ratio=self._brakes.servo_ratio,
            brake_ratio=self._brakes.pedal_ratio,
            lateral_acceleration_mps2=chassis.accel_lateral_mps2,
            longitudinal_acceleration_mps2=chassis.accel_longitudinal_mps2,
            motor_torque_nm=self._traction.torque_nm,
            relay_closed=self._hardware.relay_closed,
            front_wheels_locked=chassis.front_lock_ratio >= 1.0,
            rear_wheels_locked=chassis.rear_lock_ratio >= 1.0,
            distance_m=chassis.distance_m,
            kinetic_energy_j=chassis.kinetic_energy_j(),
        )

    @property
    def parts(self) -> Parts:
        """The car's parts, for whoever only looks."""
        return Parts(self._chassis, self._column, self._brakes, self._traction, self._hardware)

    def _integrate(self, now_ns: int) -> None:
        driver = self.driver
        faults = self.faults
        hardware = self._hardware
        circuits = self._circuits
        column = self._column
        chassis = self._chassis
        traction = self._traction
        brakes = self._brakes
        motor_encoder = self._motor_encoder
        wheel_encoder = self._wheel_encoder
        aligning_per_n = self._aligning_per_n
        wheel_offset_left_m = self._wheel_offset_left_m
        step_ns = self._step_ns
        self._apply_road()
        driver_torque_nm = driver.steering_torque_nm
        foot_ratio = driver.brake_pedal_ratio
        pedal_ratio = driver.throttle_pedal_ratio
        assert 0.0 <= foot_ratio <= 1.0 and 0.0 <= pedal_ratio <= 1.0, driver
        motor_alive = not (faults.steering_motor_fault or faults.steering_motor_dead)
        servo_alive = not faults.servo_dead
        servo_stuck = faults.servo_stuck
        servo_slow_factor = faults.servo_slow_factor
        traction_dead = faults.traction_dead
        stuck = faults.reverse_contact_stuck

        begin_ns = self._end_ns
        hardware.resolve(begin_ns, pedal_ratio)
        while begin_ns < now_ns:
            if begin_ns >= hardware.changes_at_ns:
                hardware.resolve(begin_ns, pedal_ratio)
            if circuits is not None:
                circuits.step(begin_ns, hardware, driver, brakes.servo_ratio)
            column.step(
                hardware.duty_ratio,
                hardware.motor_powered and motor_alive,
                driver_torque_nm,
                aligning_per_n * chassis.front_axle_force_lateral_n,
                chassis.speed_mps,
            )
            traction.is_reverse = hardware.reverse_selected if stuck is None else stuck
            drive_n = traction.step(
                hardware.drive_ratio,
                hardware.regen_ratio,
                traction_dead,
                chassis.front_wheel_speed_mps,
            )
            brake_n = brakes.step(
                hardware.servo_target_ratio,
                hardware.servo_powered and servo_alive,
                servo_slow_factor,
                servo_stuck,
                foot_ratio,
            )
            chassis.step(column.road_wheel_rad, drive_n, brake_n)
            motor_encoder.step(begin_ns, chassis.front_wheel_speed_mps)
            wheel_encoder.step(
                begin_ns,
                (chassis.speed_mps - wheel_offset_left_m * chassis.yaw_rate_radps)
                * (1.0 - chassis.rear_lock_ratio),
            )
            begin_ns += step_ns
        self._end_ns = begin_ns

    def _apply_road(self) -> None:
        faults = self.faults
        params = self.params.chassis
        mu = faults.friction_mu
        slope = faults.slope_rad
        road = (
            params.friction_mu if mu is None else mu,
            params.slope_rad if slope is None else slope,
            faults.load_kg,
        )
        if road != self._road:
            self._road = road
            self._chassis.set_road(*road)
