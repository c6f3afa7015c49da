"""UWA's car as its paper measured it: what the paper tells of actuators and sensors.

Everything else is the plant that is derived from the vehicle file. Fitted numbers were found with
the paper's own controller on this plant (`experiments/uwa`); a test pins them.
"""

from dataclasses import replace
from typing import Final

from simulation.plant.params import NS_PER_S, CircuitParams, PlantParams, ServoHeatParams

HALL_SPAN_V: Final = 4.0
HALL_MIDDLE_V: Final = 2.5
"""Honeywell HRS100SSAB-090 (UWA 4.2); assumption: 0.5 V to 4.5 V over its 90 deg."""
ADC_STEP_V: Final = 5.0 / 1023
"""Arduino Uno (UWA 2): 10 bit over 5 V."""
SENSOR_RANGE_RAD: Final = 4.4
"""Of the column. Assumption: gears that use the sensor's whole range, the vehicle file's +-2.2."""
ADC_STEP_RAD: Final = SENSOR_RANGE_RAD / HALL_SPAN_V * ADC_STEP_V

CIRCUITS: Final = CircuitParams(
    pedal_ratio=0.08,  # assumption: a little above the 6 % that the nodes take for a foot
    braking_ratio=0.05,  # assumption: beyond the pads' clearance
    torque_nm=4.0,  # assumption: above the 2.5 N.m by which the nodes hand over
    duty_ratio=0.03,  # assumption: what the comparators can tell from nothing
    # assumption: twice the nodes' debounce, so that living nodes act first and tell why
    delay_ns=100_000_000,
    line_ns=200_000_000,  # assumption: many cycles of a node
    # assumption: longer than a stop from the top speed by the wet road's front wheels (3.7 s), and
    # a third of what the servo may be on (the vehicle file's 30 s)
    brake_ns=10 * NS_PER_S,
)
"""UWA Section 6 gives the logic, and no numbers."""

SERVO_HEAT: Final = ServoHeatParams(time_constant_s=180.0, burnt_ratio=0.49)
"""UWA Table 2: "servomotor pole burnout". Assumption: after two minutes of a full pull."""


def column_angle_rad(volts: float) -> float:
    """What the steering ECU makes of the hall sensor's voltage; 0 V and 5 V are a broken wire."""
    return (volts - HALL_MIDDLE_V) / HALL_SPAN_V * SENSOR_RANGE_RAD


def as_measured(pattern: PlantParams) -> PlantParams:
    """The plant with what UWA's paper tells in place of what is derived."""
    return replace(
        pattern,
        hardware=replace(pattern.hardware, circuits=CIRCUITS),
        steering=replace(
            pattern.steering,
            # assumption: gearbox and belt take 7 % of the motor; the vehicle file's friction has
            # the standing tyres' scrub in it, which is a number of its own here
            coulomb_torque_nm=3.1,
        ),
        brakes=replace(
            pattern.brakes,
            # fitted to UWA Section 8: an error of 0.6 deg on the average; assumption: of 90 deg
            servo_dead_band_ratio=0.010,
            servo_heat=SERVO_HEAT,
        ),
        sensors=replace(
            pattern.sensors,
            column_angle_step_rad=ADC_STEP_RAD,
            # assumption: half a step of the ADC
            column_angle_noise_rad=0.5 * ADC_STEP_RAD,
            # fitted to UWA Table 3: the errors to both sides differ
            column_angle_zero_rad=0.013,
        ),
    )
