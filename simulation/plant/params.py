"""The truth about each simulated car: what the plant is, not what the nodes believe.

Vehicle files say what controllers assume. These numbers differ from them on purpose by a few
percent (tyre rolling radius, gear efficiency, friction, sensor zero), as a real car does.
"""

from dataclasses import dataclass, replace
from typing import Final

from simulation.drives.motor import MotorParams

GRAVITY_MPS2: Final = 9.80665  # standard gravity, ISO 80000-3
AIR_DENSITY_KG_PER_M3: Final = 1.20  # ISO 2533 at about 20 degC
NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class SteeringColumnParams:
    """Column with an EPS motor behind a worm gear; torques and inertias seen at the column."""

    column_to_road_wheel_ratio: float
    end_stop_rad: float
    hand_wheel_inertia_kgm2: float
    column_inertia_kgm2: float
    motor_stall_torque_nm: float
    motor_no_load_speed_radps: float
    coulomb_torque_nm: float
    viscous_nm_per_radps: float
    scrub_torque_nm: float
    scrub_speed_mps: float
    trail_m: float
    dead_time_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TractionParams:
    """Asynchronous motor, its controller and the reduction gearbox to the front wheels."""

    gear_ratio: float
    motor_torque_nm_max: float
    motor_power_w_max: float
    motor_speed_radps_max: float
    regen_torque_nm_max: float
    regen_fade_speed_mps: float
    gear_efficiency_ratio: float
    dead_time_ns: int
    torque_lag_s: float
    signal_idle_v: float
    signal_full_v: float
    dac_reference_v: float
    dac_steps: int
    signal_threshold_v: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoHeatParams:
    """How a servo that pulls for too long burns: heat follows the square of its pull."""

    time_constant_s: float
    burnt_ratio: float  # of the heat of a full pull for ever; there its poles burn, for good


@dataclass(frozen=True, slots=True, kw_only=True)
class BrakeParams:
    """UWA's brake servo on the pedal of UAH's car (UAH had none: an assumption as a whole)."""

    servo_travel_s: float
    servo_return_s: float
    servo_dead_band_ratio: float
    force_full_n: float
    pad_clearance_ratio: float
    front_share_ratio: float
    servo_heat: ServoHeatParams | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ChassisParams:
    """Body and tyres of a bicycle model; stiffness values are per axle."""

    wheelbase_m: float
    track_m: float
    empty_mass_kg: float
    occupant_mass_kg: float
    occupants_count: int
    front_load_share_ratio: float
    centre_height_m: float
    yaw_radius_of_gyration_m: float
    front_cornering_stiffness_n_per_rad: float
    rear_cornering_stiffness_n_per_rad: float
    longitudinal_slip_stiffness_n: float
    friction_mu: float
    wheel_radius_m: float
    rolling_resistance_ratio: float
    drag_area_m2: float
    rotating_inertia_kgm2: float
    axle_inertia_kgm2: float
    kinematic_speed_mps: float
    dynamic_speed_mps: float
    slope_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorParams:
    """Noise (standard deviation), quantisation and zero errors of the sensors."""

    column_angle_noise_rad: float
    column_angle_step_rad: float
    column_angle_zero_rad: float
    torque_noise_nm: float
    torque_zero_nm: float
    torque_nm_max: float
    torque_filter_s: float
    motor_pulses_per_rev: int
    wheel_pulses_per_rev: int
    wheel_encoder_offset_left_m: float
    encoder_timer_ns: int
    edge_age_ns_max: int
    throttle_pedal_steps: int
    brake_pedal_steps: int
    servo_steps: int
    pedal_noise_ratio: float
    servo_noise_ratio: float
    slope_zero_rad: float
    slope_noise_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CircuitParams:
    """UWA's safety circuits (Section 6); see `circuits.py`."""

    pedal_ratio: float  # the brake pedal's switch closes
    braking_ratio: float  # a servo further than this brakes
    torque_nm: float  # on the hand wheel, against the motor
    duty_ratio: float  # a motor driver's voltage below this pulls no way
    delay_ns: int  # of the filter before the emergency-brake line
    line_ns: int  # the line stays raised for the nodes to see it
    brake_ns: int  # the servo is held full for so long


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareParams:
    """Circuits that work with every ECU's software stopped."""

    watchdog_ns: int
    circuits: CircuitParams | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveTrainParams:
    """Motor drives on the bus that turn steering and rear wheels."""

    steering_node_id: int
    left_wheel_node_id: int
    right_wheel_node_id: int
    steering_gear_ratio: float
    steering_motor: MotorParams
    wheel_motor: MotorParams
    tyre_damping_n_per_mps: float  # of one wheel, lengthwise: rim against road


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkageParams:
    """From the steering's shaft to the road wheels; all angles at the imagined middle wheel."""

    transmission_ratio: float  # of the road wheel's angle to the one that the column's ratio gives
    play_rad: float  # hysteresis: half of what the shaft turns back before the wheels follow
    dead_zone_rad: float  # half of what it turns about straight ahead without effect


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantParams:
    """Everything the plant knows about one car."""

    name: str
    step_ns: int  # integration step
    steering: SteeringColumnParams
    traction: TractionParams
    brakes: BrakeParams
    chassis: ChassisParams
    sensors: SensorParams
    hardware: HardwareParams
    drives: DriveTrainParams | None = None
    linkage: LinkageParams | None = None  # none: tight

    def __post_init__(self) -> None:
        assert self.step_ns > 0 and self.mass_kg > 0.0
        # the delay lines and the watchdogs need several steps to be told apart
        assert self.steering.dead_time_ns >= 2 * self.step_ns
        assert self.traction.dead_time_ns >= 2 * self.step_ns
        assert self.hardware.watchdog_ns >= 5 * self.step_ns
        # the encoder sits on one of the wheels, or reads their mean
        assert abs(self.sensors.wheel_encoder_offset_left_m) <= 0.5 * self.chassis.track_m
        assert 0.0 < self.chassis.kinematic_speed_mps < self.chassis.dynamic_speed_mps

    @property
    def mass_kg(self) -> float:
        """Mass with the occupants on board."""
        chassis = self.chassis
        return chassis.empty_mass_kg + chassis.occupants_count * chassis.occupant_mass_kg

    def with_occupants(self, count: int) -> "PlantParams":
        """The same car with another number of people on board."""
        return replace(self, chassis=replace(self.chassis, occupants_count=count))


TABBY_EVO: Final = PlantParams(
    name="tabby_evo",
    # halving the step changes a manoeuvre by less than the sensors can tell (see the tests)
    step_ns=2_000_000,
    steering=SteeringColumnParams(
        # UAH Eq. 13: alpha = 40 * theta
        column_to_road_wheel_ratio=40.0,
        # UAH: the steering wheel's range is +-9.25 rad; assumption: the rubber stops lie 0.1 rad
        # outside it, so that a controller which keeps the range does not lean on them.
        end_stop_rad=9.35,
        # assumption: hand wheel of 2 kg and 0.37 m
        hand_wheel_inertia_kgm2=0.03,
        # assumption: 2.0e-4 kg m2 rotor behind a 20:1 worm, plus gear, tie rods and road wheels
        column_inertia_kgm2=0.085,
        # assumption: IBT-2 at 12 V, limited to about 20 A through the EPS motor (0.04 N m/A, 20:1)
        motor_stall_torque_nm=16.0,
        # assumption: the speed where the back-EMF equals the supply; with the friction below the
        # loaded free speed is 674 deg/s, which the 650 ms rise of UAH Fig. 25a needs
        motor_no_load_speed_radps=14.0,
        # assumption: bearings and worm, back-drivable as in a production EPS column
        coulomb_torque_nm=0.8,
        viscous_nm_per_radps=0.15,
        # assumption: 100 N m of tyre scrub at the road wheels at standstill, gone at 1 m/s
        scrub_torque_nm=2.5,
        scrub_speed_mps=1.0,
        # assumption: caster plus pneumatic trail
        trail_m=0.05,
        # assumption: PWM update, motor inductance and gear slack together
        dead_time_ns=20_000_000,
    ),
    traction=TractionParams(
        gear_ratio=5.8,  # UAH Table 1
        motor_torque_nm_max=128.0,  # UAH Table 1, at 500 rpm
        motor_power_w_max=29_500.0,  # UAH Table 1, at 2500 rpm
        motor_speed_radps_max=575.96,  # UAH Table 1: 5500 rpm
        # assumption: about half of the drive torque
        regen_torque_nm_max=60.0,
        # assumption: an asynchronous machine loses its regeneration below walking pace (5 km/h)
        regen_fade_speed_mps=1.389,
        gear_efficiency_ratio=0.94,  # assumption: one-stage gearbox and differential
        dead_time_ns=40_000_000,  # assumption: the AC-L1 filters and samples its input
        torque_lag_s=0.08,  # assumption: flux and the controller's torque ramp
        # UAH 4.2: 0.5 V idle .. 4.5 V full, from a 12-bit DAC (MCP4725) at 5 V
        signal_idle_v=0.5,
        signal_full_v=4.5,
        dac_reference_v=5.0,
        dac_steps=4096,
        # assumption: the controller's thresholds lie just inside, so that both ends are reached
        signal_threshold_v=0.01,
    ),
    brakes=BrakeParams(
        servo_travel_s=0.29,  # UWA Testing: released to full in 0.29 s
        # assumption: the pedal's return spring drives the unpowered servo back a little faster
        servo_return_s=0.25,
        # UWA: 0.6 deg repeatability; assumption: of 90 deg of travel
        servo_dead_band_ratio=0.006,
        # assumption: 7 m/s2 on the car with two people (880 kg)
        force_full_n=6160.0,
        pad_clearance_ratio=0.03,  # assumption: travel before the pads touch
        front_share_ratio=0.65,  # assumption: usual for this load transfer
    ),
    chassis=ChassisParams(
        wheelbase_m=2.360,  # UAH Table 1
        track_m=1.315,  # UAH Table 1
        empty_mass_kg=730.0,  # UAH Table 1, batteries included
        occupant_mass_kg=75.0,  # Regulation (EU) 1230/2012 counts a driver as 75 kg
        occupants_count=2,  # UAH 5.1: the loop was tuned with two people
        # assumption: centre of gravity a little in front of the middle (motor in front)
        front_load_share_ratio=0.52,
        centre_height_m=0.50,  # assumption: batteries under the floor
        yaw_radius_of_gyration_m=1.02,  # assumption: about sqrt(a * b) of this wheelbase
        # assumption: about 12.5 times the axle load per radian; slightly understeering
        front_cornering_stiffness_n_per_rad=55_000.0,
        rear_cornering_stiffness_n_per_rad=62_000.0,
        longitudinal_slip_stiffness_n=90_000.0,  # assumption: 20 times the front axle load
        friction_mu=0.9,  # assumption: dry asphalt
        # UAH's tyre is 175/55R15, 0.287 m; assumption: 1 % less when loaded and rolling
        wheel_radius_m=0.284,
        rolling_resistance_ratio=0.014,  # assumption: tyres, hubs and gearbox drag
        drag_area_m2=0.80,  # assumption: open chassis, two people (cd * A)
        # assumption: four wheels of 0.8 kg m2 and the rotor's 0.025 kg m2 through 5.8:1
        rotating_inertia_kgm2=4.0,
        axle_inertia_kgm2=2.4,  # assumption: one axle's share, for a wheel that locks
        # below the first speed the car rolls without slip, above the second tyres slip freely
        kinematic_speed_mps=1.0,
        dynamic_speed_mps=2.0,
        slope_rad=0.0,  # positive uphill
    ),
    sensors=SensorParams(
        # UAH 4.1: vernier of two KMZ41 on an ADS1115 (16 bit); assumption: noise after averaging
        column_angle_noise_rad=0.0015,
        column_angle_step_rad=0.0005,
        column_angle_zero_rad=0.015,  # assumption: mounting error left after calibration
        # assumption: strain gauges with a 10 ms analogue filter and +-15 N m of range
        torque_noise_nm=0.05,
        torque_zero_nm=0.03,
        torque_nm_max=15.0,
        torque_filter_s=0.010,
        motor_pulses_per_rev=64,  # UAH 4.2: E68EC080A
        wheel_pulses_per_rev=360,  # UAH 3.4: Kuebler 8.3700.1322.0360
        # UAH 3.4 has one on each rear wheel; the brake ECU reads the left one
        wheel_encoder_offset_left_m=0.6575,
        encoder_timer_ns=1_000,  # assumption: 1 us capture timer of an STM32
        edge_age_ns_max=NS_PER_S,
        throttle_pedal_steps=1023,  # assumption: 10-bit ADC
        brake_pedal_steps=4095,  # assumption: 12-bit ADC
        servo_steps=1023,  # assumption: 10-bit ADC on the servo's potentiometer
        pedal_noise_ratio=0.001,
        servo_noise_ratio=0.002,
        # assumption: a MEMS inclinometer, 0.3 deg askew, 0.2 deg of noise
        slope_zero_rad=0.005,
        slope_noise_rad=0.0035,
    ),
    hardware=HardwareParams(
        watchdog_ns=50_000_000,  # design: one per actuator
    ),
)

_PARAMS_BY_NAME: Final = {params.name: params for params in (TABBY_EVO,)}
NAMES: Final = frozenset(_PARAMS_BY_NAME)
"""Vehicles with a plant of their own."""


def plant_params(vehicle_name: str) -> PlantParams:
    """The plant of a vehicle by the name of its vehicle file.

    Raises:
        ValueError: No plant has this name; the message lists those that exist.
    """
    try:
        return _PARAMS_BY_NAME[vehicle_name]
    except KeyError:
        known = ", ".join(sorted(_PARAMS_BY_NAME))
        raise ValueError(f"no plant named {vehicle_name!r}; known plants: {known}") from None
