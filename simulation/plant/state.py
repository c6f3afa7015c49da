"""Plain data about the plant: where the car is, what the driver does, what is broken."""

from dataclasses import dataclass
from typing import Final


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Pose:
    """Position of the rear-axle centre and direction of travel.

    Attributes:
        x_m: East, or whatever the track's x is.
        y_m: North.
        heading_rad: From x towards y, not wrapped: a full left circle adds 2 pi.
    """

    x_m: Final[float]
    y_m: Final[float]
    heading_rad: Final[float]

    def __init__(self, *, x_m: float, y_m: float, heading_rad: float) -> None:
        self.x_m = x_m
        self.y_m = y_m
        self.heading_rad = heading_rad


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Truth:
    """The car as it is at one instant, without any sensor between.

    Attributes:
        time_ns: Virtual time of the snapshot.
        pose: Rear-axle centre at that time.
        speed_mps: At the rear-axle centre, negative when rolling backwards.
        yaw_rate_radps: Positive to the left.
        column_angle_rad: Steering column, without the sensor's zero error.
        column_rate_radps: Its rate.
        road_wheel_angle_rad: Of the imaginary wheel in the middle of the front axle.
        servo_position_ratio: Brake servo, 0 released to 1 full.
        brake_ratio: Position of the brake pedal, which is what the brakes get: the servo or the
            driver's foot, whichever is further.
        lateral_acceleration_mps2: At the centre of gravity, positive to the left.
        longitudinal_acceleration_mps2: At the centre of gravity.
        motor_torque_nm: Traction motor; negative when it regenerates.
        relay_closed: The manual/automatic relay (closed = automatic).
        front_wheels_locked: The front wheels slide under the brakes.
        rear_wheels_locked: The rear wheels slide under the brakes.
        distance_m: Way travelled, forwards and backwards both counted up.
        kinetic_energy_j: Of the body and of all that rotates with the wheels.
    """

    time_ns: Final[int]
    pose: Final[Pose]
    speed_mps: Final[float]
    yaw_rate_radps: Final[float]
    column_angle_rad: Final[float]
    column_rate_radps: Final[float]
    road_wheel_angle_rad: Final[float]
    servo_position_ratio: Final[float]
    brake_ratio: Final[float]
    lateral_acceleration_mps2: Final[float]
    longitudinal_acceleration_mps2: Final[float]
    motor_torque_nm: Final[float]
    relay_closed: Final[bool]
    front_wheels_locked: Final[bool]
    rear_wheels_locked: Final[bool]
    distance_m: Final[float]
    kinetic_energy_j: Final[float]

    def __init__(
        self,
        *,
        time_ns: int,
        pose: Pose,
        speed_mps: float,
        yaw_rate_radps: float,
        column_angle_rad: float,
        column_rate_radps: float,
        road_wheel_angle_rad: float,
        servo_position_ratio: float,
        brake_ratio: float,
        lateral_acceleration_mps2: float,
        longitudinal_acceleration_mps2: float,
        motor_torque_nm: float,
        relay_closed: bool,
        front_wheels_locked: bool,
        rear_wheels_locked: bool,
        distance_m: float,
        kinetic_energy_j: float,
    ) -> None:
        self.time_ns = time_ns
        self.pose = pose
        self.speed_mps = speed_mps
        self.yaw_rate_radps = yaw_rate_radps
        self.column_angle_rad = column_angle_rad
        self.column_rate_radps = column_rate_radps
        self.road_wheel_angle_rad = road_wheel_angle_rad
        self.servo_position_ratio = servo_position_ratio
        self.brake_ratio = brake_ratio
        self.lateral_acceleration_mps2 = lateral_acceleration_mps2
        self.longitudinal_acceleration_mps2 = longitudinal_acceleration_mps2
        self.motor_torque_nm = motor_torque_nm
        self.relay_closed = relay_closed
        self.front_wheels_locked = front_wheels_locked
        self.rear_wheels_locked = rear_wheels_locked
        self.distance_m = distance_m
        self.kinetic_energy_j = kinetic_energy_j


@dataclass(slots=True)
class DriverInputs:
    """What the human does now; the world writes it, the plant reads it at its next step.

    Attributes:
        steering_torque_nm: On the hand wheel, positive to the left.
        throttle_pedal_ratio: 0..1.
        brake_pedal_ratio: The foot on the brake pedal, 0..1.
        button_pressed: The manual/automatic button.
        emergency_stop_pressed: The emergency-stop button.
    """

    steering_torque_nm: float = 0.0
    throttle_pedal_ratio: float = 0.0
    brake_pedal_ratio: float = 0.0
    button_pressed: bool = False
    emergency_stop_pressed: bool = False


@dataclass(slots=True)
class PlantFaults:
    """What is broken or different in the world; the plant reads it at its next step.

    An override replaces a reading as it reaches the ECU, without noise or quantisation; None
    means that the sensor works.

    Attributes:
        steering_angle_override_rad: Reading of the column-angle sensor; NaN = unreadable.
        steering_angle_stuck: The reading freezes at its last value.
        steering_torque_override_nm: Reading of the torque sensor.
        steering_motor_fault: The motor driver raises its fault line and opens its outputs.
        steering_motor_dead: The motor gives no torque and nothing reports it.
        traction_dead: The traction motor gives no torque and nothing reports it.
        servo_stuck: The brake servo stays where it is, whatever is asked.
        servo_dead: The brake servo has no power and returns by its spring.
        servo_slow_factor: Its travel takes this many times longer; at least 1.
        servo_position_override_ratio: Reading of the servo's position.
        motor_encoder_dead: No further edges from the traction motor's encoder.
        wheel_encoder_dead: No further edges from the rear-wheel encoder.
        throttle_pedal_override_ratio: Reading of the throttle pedal.
        brake_pedal_override_ratio: Reading of the brake pedal.
        relay_stuck: The manual/automatic relay does not move.
        reverse_contact_stuck: The reverse contact stays closed (True) or open (False), whatever is
            asked of it.
        slope_rad: Slope of the road, positive uphill; None = the plant's own number.
        friction_mu: Friction between tyre and road; None = the plant's own number.
        load_kg: On top of the plant's own mass.
    """

    steering_angle_override_rad: float | None = None
    steering_angle_stuck: bool = False
    steering_torque_override_nm: float | None = None
    steering_motor_fault: bool = False
    steering_motor_dead: bool = False
    traction_dead: bool = False
    servo_stuck: bool = False
    servo_dead: bool = False
    servo_slow_factor: float = 1.0
    servo_position_override_ratio: float | None = None
    motor_encoder_dead: bool = False
    wheel_encoder_dead: bool = False
    throttle_pedal_override_ratio: float | None = None
    brake_pedal_override_ratio: float | None = None
    relay_stuck: bool = False
    reverse_contact_stuck: bool | None = None
    slope_rad: float | None = None
    friction_mu: float | None = None
    load_kg: float = 0.0
