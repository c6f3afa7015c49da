"""A plant for a vehicle that nobody has measured: what its file says, and a few percent off.

The pattern is TABBY EVO: what a vehicle file does not tell (tyres, drag, sensor noise) is TABBY's,
scaled by mass, wheelbase or radius; what it tells is the truth but for the deviations that TABBY's
plant has from TABBY's file, since no controller may be tested against a perfect model of itself.
Assumptions as a whole: such a plant shows that a stack runs and stops, not how well it is tuned.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from simulation.drives.motor import EC45, EC45_ROTOR_KGM2, RE50, RE50_ROTOR_KGM2
from simulation.plant import fsae_electric
from simulation.plant.params import (
    NAMES,
    TABBY_EVO,
    ChassisParams,
    DriveTrainParams,
    PlantParams,
    SensorParams,
    SteeringColumnParams,
    TractionParams,
    plant_params,
)
from vehicles import Vehicle, load_vehicle
from vehicles.vehicle import Drives

TYRE_WALKING_MPS: Final = 0.5
"""Slip is told at this speed whatever the car's: a tyre's stiffness becomes a damping."""

OCCUPIED_KG_MIN: Final = 400.0
"""A lighter vehicle carries nobody."""


MEASURED: Final[dict[str, Callable[[PlantParams], PlantParams]]] = {
    "fsae_electric": fsae_electric.as_measured,
}
"""Vehicles of which a paper has measured a part."""


def plant_of(vehicle: Vehicle) -> PlantParams:
    """The plant of a vehicle: its own by name if it has one, else one derived from its file."""
    if vehicle.name in NAMES:
        return plant_params(vehicle.name)
    plant = derived(vehicle)
    return MEASURED[vehicle.name](plant) if vehicle.name in MEASURED else plant


def derived(vehicle: Vehicle) -> PlantParams:
    """TABBY EVO's plant, scaled to another vehicle file; TABBY's own file gives TABBY's plant."""
    pattern, believed = TABBY_EVO, load_vehicle(TABBY_EVO.name)
    mass = vehicle.geometry.mass_kg / believed.geometry.mass_kg
    length = vehicle.geometry.wheelbase_m / believed.geometry.wheelbase_m
    width = vehicle.geometry.track_m / believed.geometry.track_m
    radius = vehicle.geometry.wheel_radius_m / believed.geometry.wheel_radius_m
    params = replace(
        pattern,
        name=vehicle.name,
        steering=_steering(vehicle, believed, mass, radius),
        traction=_traction(vehicle, believed),
        brakes=replace(
            pattern.brakes,
            servo_travel_s=vehicle.brake.full_travel_s,
            servo_return_s=pattern.brakes.servo_return_s
            * vehicle.brake.full_travel_s / believed.brake.full_travel_s,
            force_full_n=pattern.brakes.force_full_n * mass
            * vehicle.brake.deceleration_mps2_full / believed.brake.deceleration_mps2_full,
        ),
        chassis=_chassis(vehicle, mass, length, width, radius),
        sensors=_sensors(vehicle, believed, width),
    )
    drives = vehicle.drives
    return params if drives is None else replace(params, drives=_drives(params, drives))


def _steering(
    vehicle: Vehicle, believed: Vehicle, mass: float, radius: float
) -> SteeringColumnParams:
    pattern, ours, theirs = TABBY_EVO.steering, vehicle.steering, believed.steering
    hands = ours.wheel_inertia_kgm2 / theirs.wheel_inertia_kgm2
    speed = ours.motor_free_speed_radps / theirs.motor_free_speed_radps
    # time constant = inertia * free speed / stall torque: for the torque that speeds the hand wheel
    # up so fast, or that the tyres' aligning torque needs, the motor's own inertia is what is left
    per_torque = ours.motor_time_constant_s / theirs.motor_time_constant_s / speed
    torque = max(hands / per_torque, mass * radius * theirs.ratio / ours.ratio)
    inertia_kgm2 = (pattern.hand_wheel_inertia_kgm2 + pattern.column_inertia_kgm2) * (
        torque * per_torque
    )
    hand_wheel_inertia_kgm2 = pattern.hand_wheel_inertia_kgm2 * hands
    friction = ours.motor_friction_duty_ratio / theirs.motor_friction_duty_ratio
    room = (pattern.end_stop_rad - theirs.wheel_angle_rad_max) / (
        theirs.sensor_angle_rad_max - theirs.wheel_angle_rad_max
    )
    beyond_rad = ours.sensor_angle_rad_max - ours.wheel_angle_rad_max
    return replace(
        pattern,
        column_to_road_wheel_ratio=ours.ratio,
        end_stop_rad=ours.wheel_angle_rad_max + room * beyond_rad,
        hand_wheel_inertia_kgm2=hand_wheel_inertia_kgm2,
        column_inertia_kgm2=inertia_kgm2 - hand_wheel_inertia_kgm2,
        motor_stall_torque_nm=pattern.motor_stall_torque_nm * torque,
        motor_no_load_speed_radps=pattern.motor_no_load_speed_radps * speed,
        coulomb_torque_nm=pattern.coulomb_torque_nm * torque * friction,
        viscous_nm_per_radps=pattern.viscous_nm_per_radps * torque / speed,
        scrub_torque_nm=pattern.scrub_torque_nm * torque,
        trail_m=pattern.trail_m * radius,
    )


def _traction(vehicle: Vehicle, believed: Vehicle) -> TractionParams:
    pattern, ours, theirs = TABBY_EVO.traction, vehicle.traction, believed.traction
    torque = ours.motor_torque_nm_max / theirs.motor_torque_nm_max
    # the motor turns so much faster at the vehicle's top speed
    speed = (ours.speed_mps_max * ours.gear_ratio / vehicle.geometry.wheel_radius_m) / (
        theirs.speed_mps_max * theirs.gear_ratio / believed.geometry.wheel_radius_m
    )
    return replace(
        pattern,
        gear_ratio=ours.gear_ratio,
        motor_torque_nm_max=ours.motor_torque_nm_max,
        motor_power_w_max=pattern.motor_power_w_max * torque * speed,
        motor_speed_radps_max=pattern.motor_speed_radps_max * speed,
        regen_torque_nm_max=ours.regen_torque_nm_max,
    )


def _chassis(
    vehicle: Vehicle, mass: float, length: float, width: float, radius: float
) -> ChassisParams:
    pattern = TABBY_EVO.chassis
    people = pattern.occupants_count if vehicle.geometry.mass_kg >= OCCUPIED_KG_MIN else 0
    return replace(
        pattern,
        wheelbase_m=vehicle.geometry.wheelbase_m,
        track_m=vehicle.geometry.track_m,
        empty_mass_kg=vehicle.geometry.mass_kg - people * pattern.occupant_mass_kg,
        occupants_count=people,
        centre_height_m=pattern.centre_height_m * length,
        yaw_radius_of_gyration_m=pattern.yaw_radius_of_gyration_m * length,
        front_cornering_stiffness_n_per_rad=pattern.front_cornering_stiffness_n_per_rad * mass,
        rear_cornering_stiffness_n_per_rad=pattern.rear_cornering_stiffness_n_per_rad * mass,
        longitudinal_slip_stiffness_n=pattern.longitudinal_slip_stiffness_n * mass,
        wheel_radius_m=pattern.wheel_radius_m * radius,
        drag_area_m2=pattern.drag_area_m2 * width**2,
        rotating_inertia_kgm2=pattern.rotating_inertia_kgm2 * mass * radius**2,
        axle_inertia_kgm2=pattern.axle_inertia_kgm2 * mass * radius**2,
    )


def _sensors(vehicle: Vehicle, believed: Vehicle, width: float) -> SensorParams:
    pattern, ours, theirs = TABBY_EVO.sensors, vehicle.steering, believed.steering
    angle = ours.wheel_angle_rad_max / theirs.wheel_angle_rad_max
    torque = ours.driver_torque_nm_max / theirs.driver_torque_nm_max
    return replace(
        pattern,
        column_angle_noise_rad=pattern.column_angle_noise_rad * angle,
        column_angle_step_rad=pattern.column_angle_step_rad * angle,
        column_angle_zero_rad=pattern.column_angle_zero_rad * angle,
        torque_noise_nm=pattern.torque_noise_nm * torque,
        torque_zero_nm=pattern.torque_zero_nm * torque,
        torque_nm_max=pattern.torque_nm_max * torque,
        motor_pulses_per_rev=round(vehicle.traction.encoder_pulses_per_rev),
        wheel_pulses_per_rev=round(vehicle.brake.wheel_encoder_pulses_per_rev),
        wheel_encoder_offset_left_m=pattern.wheel_encoder_offset_left_m * width,
    )


def _drives(params: PlantParams, drives: Drives) -> DriveTrainParams:
    """UNICAMP's motors, each with what hangs on it."""
    steering, chassis, gear = params.steering, params.chassis, params.traction.gear_ratio
    column_kgm2 = steering.hand_wheel_inertia_kgm2 + steering.column_inertia_kgm2
    # the tyres' scrub at a standstill, also while they roll
    column_nm = steering.coulomb_torque_nm + steering.scrub_torque_nm
    steering_gear = drives.steering_gear_ratio
    per_wheel = 0.5 / gear**2
    return DriveTrainParams(
        steering_node_id=drives.steering_node_id,
        left_wheel_node_id=drives.left_wheel_node_id,
        right_wheel_node_id=drives.right_wheel_node_id,
        steering_gear_ratio=steering_gear,
        steering_motor=replace(
            EC45,
            inertia_kgm2=EC45_ROTOR_KGM2 + column_kgm2 / steering_gear**2,
            friction_nm=EC45.friction_nm + column_nm / steering_gear,
            stop_rad=steering.end_stop_rad * steering_gear,
        ),
        wheel_motor=replace(
            RE50,
            inertia_kgm2=RE50_ROTOR_KGM2 + chassis.axle_inertia_kgm2 * per_wheel,
            carried_inertia_kgm2=params.mass_kg * chassis.wheel_radius_m**2 * per_wheel,
        ),
        tyre_damping_n_per_mps=0.5 * chassis.longitudinal_slip_stiffness_n / TYRE_WALKING_MPS,
    )
