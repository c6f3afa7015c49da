"""UNICAMP's three drives on one wire, with a steering and a throttle node that command them."""

from __future__ import annotations

import math

import pytest

from canbus.cia402 import RPM_PER_RADPS
from canbus.cia402_power import PowerState
from canbus.drive_client import DriveTrouble
from experiments.unicamp.drive_bus import LEFT, RIGHT, STEER, DriveBus, drive_name
from gateway.kinematics import Kinematics
from gateway.motion_commands import decide_cmd_vel
from simulation.drives.motor import COUNTS_PER_REV, EC45, RE50, Motor
from vehicles import load_vehicle

MS = 1_000_000
BAJA = load_vehicle("baja_5b")
KIN = Kinematics.of(BAJA.geometry, BAJA.steering)
STEERING_GEAR = 10.0
"""Turns of the steering motor to one of its gear's shaft: this test's own."""


class Everyone(DriveBus):
    """The wire with three drives, the two nodes, and a supervisor that starts the drives."""

    def __init__(self) -> None:
        self.motors = {STEER: Motor(EC45), LEFT: Motor(RE50), RIGHT: Motor(RE50)}
        super().__init__(self.motors, drive_period_ns=MS)

    def drive_circle(self, speed_mps: float, yaw_rate_radps: float) -> None:
        decision = decide_cmd_vel(BAJA, speed_mps=speed_mps, yaw_rate_radps=yaw_rate_radps)
        wheels = KIN.rear_wheel_speeds_mps(decision.speed_mps, decision.curvature_per_m)
        shaft_rad = KIN.steering_wheel_angle_rad(decision.curvature_per_m)
        self.values = {
            STEER: round(shaft_rad * STEERING_GEAR * COUNTS_PER_REV / math.tau),
            LEFT: rpm(wheels.left_mps),
            RIGHT: rpm(wheels.right_mps),
        }

    def wheel_mps(self, node_id: int) -> float:
        """What the motor's wheel really does."""
        shaft_radps = self.motors[node_id].speed_radps / BAJA.traction.gear_ratio
        return shaft_radps * BAJA.geometry.wheel_radius_m


def rpm(wheel_mps: float) -> int:
    wheel_radps = wheel_mps / BAJA.geometry.wheel_radius_m
    return round(wheel_radps * BAJA.traction.gear_ratio * RPM_PER_RADPS)


@pytest.mark.parametrize("radius_m", [1.6, 2.0, -1.6, -2.0])
def test_cmd_vel_turns_three_motors_as_the_circle_wants(radius_m: float) -> None:
    everyone = Everyone()
    everyone.start()
    everyone.drive_circle(0.4, 0.4 / radius_m)
    everyone.run_for(1.5)
    left, right = everyone.wheel_mps(LEFT), everyone.wheel_mps(RIGHT)
    assert (left + right) / 2 == pytest.approx(0.4, rel=0.01)
    assert (right - left) / BAJA.geometry.track_m == pytest.approx(0.4 / radius_m, rel=0.03)
    shaft_rad = everyone.motors[STEER].angle_rad / STEERING_GEAR
    assert KIN.curvature_per_m(shaft_rad) == pytest.approx(1 / radius_m, rel=0.01)


def test_a_throttle_node_that_dies_stops_both_wheels_and_not_the_steering() -> None:
    everyone = Everyone()
    everyone.start()
    everyone.drive_circle(0.4, 0.25)
    everyone.run_for(1.0)
    everyone.dead.add("Throttle")
    everyone.run_for(0.3)
    for node_id in (LEFT, RIGHT):
        assert everyone.drives[node_id].state is PowerState.FAULT
        assert everyone.wheel_mps(node_id) == pytest.approx(0.0, abs=0.01)
    assert everyone.drives[STEER].state is PowerState.OPERATION_ENABLED


def test_a_drive_that_dies_is_the_trouble_of_its_node_alone() -> None:
    everyone = Everyone()
    everyone.start()
    everyone.drive_circle(0.4, 0.25)
    everyone.run_for(1.0)
    everyone.dead.add(drive_name(LEFT))
    everyone.run_for(0.09)
    troubles = {node_id: client.trouble for node_id, client in everyone.clients.items()}
    assert troubles == {STEER: None, LEFT: DriveTrouble.SILENT, RIGHT: None}


def test_three_drives_take_less_than_a_third_of_the_wire_and_no_errors() -> None:
    everyone = Everyone()
    everyone.start()
    everyone.drive_circle(0.4, 0.25)
    busy_ns, start_ns = everyone.wire.busy_ns, everyone.kernel.now_ns
    everyone.run_for(1.0)
    share = (everyone.wire.busy_ns - busy_ns) / (everyone.kernel.now_ns - start_ns)
    assert 0.1 < share < 1 / 3
    assert everyone.wire.error_frames == 0
    assert all(client.bad_frames == 0 for client in everyone.clients.values())
