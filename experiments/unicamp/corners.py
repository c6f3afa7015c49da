"""Cars that are not quite the one believed in: 20 % of error, friction, payload, floor."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from experiments.unicamp.plant import BAJA, PlantParams
from gateway.kinematics import Kinematics
from simulation.drives.motor import MotorParams


@dataclass(frozen=True, slots=True, kw_only=True)
class Corner:
    """One thing that is different."""

    name: str
    plant: PlantParams
    is_of_tuning: bool = True
    """Whether it makes a difference to the curvature control."""


def radius_m_min(plant: PlantParams) -> float:
    """The smallest circle of a car whose steering motor goes as far as the vehicle file lets it."""
    kinematics = Kinematics.of(BAJA.geometry, BAJA.steering)
    linkage = plant.linkage
    told_rad = kinematics.road_wheel_angle_rad(BAJA.curvature_per_m_max)
    road_rad = told_rad - linkage.play_rad - linkage.dead_zone_rad
    return kinematics.wheelbase_m / math.tan(linkage.transmission_ratio * road_rad)


def corners(plant: PlantParams) -> tuple[Corner, ...]:
    """The car itself, and with one thing changed at a time."""

    def linkage(name: str, *, play: float = 1.0, transmission: float = 1.0) -> Corner:
        old = plant.linkage
        return Corner(name=name, plant=replace(plant, linkage=replace(
            old, play_rad=play * old.play_rad, dead_zone_rad=play * old.dead_zone_rad,
            transmission_ratio=transmission * old.transmission_ratio,
        )))  # fmt: skip

    def tyres(name: str, *, side: float = 1.0, rolling: float = 1.0) -> Corner:
        old = plant.tyres
        return Corner(name=name, is_of_tuning=side != 1.0, plant=replace(plant, tyres=replace(
            old, cornering_stiffness_ratio=side * old.cornering_stiffness_ratio,
            rolling_ratio=rolling * old.rolling_ratio,
        )))  # fmt: skip

    def motors(name: str, *, friction: float = 1.0, torque: float = 1.0) -> Corner:
        def changed(motor: MotorParams) -> MotorParams:
            return replace(
                motor, friction_nm=friction * motor.friction_nm,
                torque_constant_nm_per_a=torque * motor.torque_constant_nm_per_a,
            )  # fmt: skip

        return Corner(name=name, is_of_tuning=False, plant=replace(
            plant, steering_motor=changed(plant.steering_motor),
            wheel_motor=changed(plant.wheel_motor),
        ))  # fmt: skip

    worse_imu = replace(plant.imu, bias_radps=-2.0 * plant.imu.bias_radps)
    return (
        Corner(name="as assumed", plant=plant),
        linkage("play and dead zone 50 % more", play=1.5),
        linkage("play and dead zone 20 % less", play=0.8),
        linkage("linkage turns 20 % less", transmission=0.8),
        linkage("linkage turns 20 % more", transmission=1.2),
        motors("friction of all motors 50 % more", friction=1.5),
        motors("all motors 20 % weaker", torque=0.8),
        Corner(name="5 kg of payload", is_of_tuning=False, plant=plant.with_load(5.0)),
        tyres("dusty floor: sideways half as stiff", side=0.5),
        tyres("rolling radius 1 % less", rolling=0.99),
        Corner(name="IMU's bias doubled, other sign", plant=replace(plant, imu=worse_imu)),
    )
