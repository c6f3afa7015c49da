"""What an oracle is told of a world: every frame, and the truth at a fixed pace."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

from oracle.judge import Oracle
from oracle.sample import Sample
from simulation.world import World

OBSERVER_PRIORITY = 3
"""After wire, nodes and planner of the same instant."""


def no_path() -> float:
    """The path error where there is no path."""
    return nan


class Observer:
    """Attaches an oracle to a world, which goes on as if nobody looked.

    Looks fall on the plant's own steps (10 ms are whole steps of 2 ms), so that they change
    nothing in it.

    Args:
        world: At its beginning.
        oracle: Told from now on.
        path_error_m: The car's distance from the path it is to drive, NaN for none.
    """

    def __init__(
        self, world: World, oracle: Oracle, path_error_m: Callable[[], float] = no_path
    ) -> None:
        self._world = world
        self._oracle = oracle
        self._path_error_m = path_error_m
        self._parts = world.car.parts
        self._period_ns = oracle.settings.sample_ns
        world.wire.witnesses.append(oracle.on_frame)
        world.kernel.at(world.now_ns, OBSERVER_PRIORITY, self._tick)

    def _tick(self, true_ns: int) -> None:
        self._world.kernel.at(true_ns + self._period_ns, OBSERVER_PRIORITY, self._tick)
        self.look()

    def look(self) -> None:
        """Tells the truth now: to be called after a change of what the driver does."""
        now_ns = self._world.now_ns
        car = self._world.car
        car.advance(now_ns)
        driver = car.driver
        chassis, column, brakes, traction, hardware = self._parts
        self._oracle.on_truth(
            Sample(
                true_ns=now_ns,
                speed_mps=chassis.speed_mps,
                longitudinal_acceleration_mps2=chassis.accel_longitudinal_mps2,
                yaw_rate_radps=chassis.yaw_rate_radps,
                column_angle_rad=column.angle_rad,
                column_rate_radps=column.rate_radps,
                steering_motor_powered=hardware.motor_powered,
                servo_powered=hardware.servo_powered,
                servo_target_ratio=hardware.servo_target_ratio,
                servo_position_ratio=brakes.servo_ratio,
                brake_ratio=brakes.pedal_ratio,
                motor_torque_nm=traction.torque_nm,
                drive_torque_nm=traction.drive_nm,
                reverse_selected=hardware.reverse_selected,
                relay_closed=hardware.relay_closed,
                steering_torque_nm=driver.steering_torque_nm,
                throttle_pedal_ratio=driver.throttle_pedal_ratio,
                brake_pedal_ratio=driver.brake_pedal_ratio,
                button_pressed=driver.button_pressed,
                emergency_stop_pressed=driver.emergency_stop_pressed,
                path_error_m=self._path_error_m(),
            )
        )
