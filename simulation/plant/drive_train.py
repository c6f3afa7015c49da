"""Steering and rear wheels on motor drives: what stands in for column, traction and circuits.

The drives belong to the car, as hardware does: they go with its time, in ticks of their own. The
manual/automatic relay gives each motor to its drive, or to the driver: the wheels' to the kit's own
speed controller, which his pedal commands (assumption). Nothing else is wired to the drives.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canbus import cia402
from canbus.canopen_protocol import HEARTBEAT_ID, NMT_ID, SDO_REQUEST_ID
from canbus.cia402_power import PowerState
from canbus.frame import Frame
from canbus.node import NODE_IDS
from ecus.steering.ports import SteeringActuator
from ecus.throttle.ports import ThrottleActuator
from oracle.drives import LEFT_DRIVE, RIGHT_DRIVE, STEERING_DRIVE
from simulation.drives.axis import TICK_S
from simulation.drives.drive import TICK_NS, EposDrive
from simulation.drives.faults import DriveFault
from simulation.drives.motor import Motor, MotorParams
from simulation.plant.chassis import Chassis
from simulation.plant.hardware import Hardware
from simulation.plant.params import NS_PER_S, DriveTrainParams, PlantParams
from simulation.plant.steering import SteeringColumn
from simulation.plant.traction import Traction

HELD: Final = frozenset(
    {
        PowerState.OPERATION_ENABLED,
        PowerState.QUICK_STOP_ACTIVE,
        PowerState.FAULT_REACTION_ACTIVE,
    }
)
"""States in which a drive may put current into its motor."""

BROKEN: Final = DriveFault.OVERCURRENT
"""What a drive that trips says: it cannot brake its motor any more."""


class DriveUnit:
    """One drive, its motor and its end of the bus.

    Attributes:
        name: Of its station on the wire.
        inbox, outbox: Frames to it and from it that wait.
        acceptance: Identifiers that it can ever want.
        is_alive: A dead one does nothing, and its motor coasts; it comes back with nothing
            remembered.
        is_mute: Its frames reach nobody.
        is_deaf: Nobody's frames reach it.
        is_tripped: Its output stage is broken: it is in FAULT.
    """

    def __init__(self, name: str, node_id: int, params: MotorParams, start_ns: int) -> None:
        self.name = name
        self.node_id = node_id
        self.motor = Motor(params)
        self.drive = EposDrive(node_id, self.motor)
        self.inbox: list[Frame] = []
        self.outbox: list[Frame] = []
        self.is_alive = True
        self.is_mute = False
        self.is_deaf = False
        self.is_tripped = False
        self._was_dead = False
        self._was_tripped = False
        bases = (cia402.TARGET_POSITION_ID, cia402.TARGET_VELOCITY_ID, SDO_REQUEST_ID)
        heartbeats = (HEARTBEAT_ID + other for other in NODE_IDS.values())
        self.acceptance = frozenset({NMT_ID, *heartbeats, *(base + node_id for base in bases)})
        self._now_ns = start_ns

    @property
    def is_holding(self) -> bool:
        """Whether the drive has the motor, and its reference stands."""
        drive = self.drive
        return drive.state in HELD and drive.values[cia402.VELOCITY_DEMAND] == 0

    def run(self, span_ns: int) -> None:
        """Goes on for so long, whole ticks."""
        self._now_ns += span_ns
        received, self.inbox = self.inbox, []
        if not self.is_alive:
            self._was_dead = True
            for _ in range(span_ns // TICK_NS):
                self.motor.step(0.0, TICK_S)
            return
        if self._was_dead:
            self.restart()
        if self.is_tripped is not self._was_tripped:
            self._was_tripped = self.is_tripped
            (self.drive.fail if self.is_tripped else self.drive.mend)(BROKEN)
        frames = self.drive.step(self._now_ns, () if self.is_deaf else received)
        if frames and not self.is_mute:
            self.outbox += frames

    def restart(self) -> None:
        """Power off and on: a new drive on the same motor."""
        self.drive = EposDrive(self.node_id, self.motor)
        self.is_alive = True
        self._was_dead = self._was_tripped = False


class DriveTrain:
    """Three drives, and the parts of the car that they make up.

    Attributes:
        steering, left, right: The drives.
        column, traction, hardware: In place of those of a car without drives.
    """

    def __init__(
        self, params: PlantParams, drives: DriveTrainParams, chassis: Chassis, start_ns: int
    ) -> None:
        assert params.step_ns % TICK_NS == 0, "the drives go in whole ticks"
        motor = drives.wheel_motor
        self.steering = DriveUnit(
            STEERING_DRIVE, drives.steering_node_id, drives.steering_motor, start_ns
        )
        self.left = DriveUnit(LEFT_DRIVE, drives.left_wheel_node_id, motor, start_ns)
        self.right = DriveUnit(RIGHT_DRIVE, drives.right_wheel_node_id, motor, start_ns)
        self.hardware = DrivenHardware(params, start_ns, self.steering)
        self.column = DrivenColumn(params, self.steering, drives.steering_gear_ratio)
        self.traction = DrivenTraction(params, drives, chassis, self)

    @property
    def units(self) -> tuple[DriveUnit, DriveUnit, DriveUnit]:
        """All drives."""
        return self.steering, self.left, self.right

    @property
    def acceptance(self) -> frozenset[int]:
        """Identifiers that some drive can want."""
        return frozenset().union(*(unit.acceptance for unit in self.units))

    def hear(self, frames: Iterable[Frame]) -> None:
        """Frames that have come over the bus; the drives see them at their next tick."""
        for frame in frames:
            for unit in self.units:
                if frame.can_id in unit.acceptance:
                    unit.inbox.append(frame)

    def take_frames(self) -> list[Frame]:
        """What the drives have sent since the last call."""
        frames = []
        for unit in self.units:
            frames += unit.outbox
            unit.outbox = []
        return frames


class DrivenHardware(Hardware):
    """Relay and brake watchdog; the relay carries the motors' supply."""

    def __init__(self, params: PlantParams, start_ns: int, steering: DriveUnit) -> None:
        super().__init__(params, start_ns)
        self._steering = steering

    def refresh_steering(self, now_ns: int, command: SteeringActuator) -> None:
        """Nothing is wired."""

    def refresh_throttle(self, now_ns: int, command: ThrottleActuator) -> None:
        """Nothing is wired."""

    def resolve(self, now_ns: int, driver_throttle_ratio: float) -> None:
        """As without drives for pedal and brake. Asked again every step."""
        super().resolve(now_ns, driver_throttle_ratio)
        unit = self._steering
        self.motor_powered = self.relay_closed and unit.is_alive and unit.drive.state in HELD
        if self.relay_closed:  # what the ECU put out before, or nothing, is not wired
            self.drive_ratio = self.regen_ratio = 0.0
        self.changes_at_ns = now_ns


class DrivenColumn(SteeringColumn):
    """The steering motor's shaft behind its gear."""

    def __init__(self, params: PlantParams, unit: DriveUnit, gear_ratio: float) -> None:
        super().__init__(params)
        self._unit = unit
        self._gear_ratio = gear_ratio
        self._step_ns = params.step_ns

    def step(
        self,
        duty: float,
        powered: bool,
        driver_torque_nm: float,
        aligning_torque_nm: float,
        speed_mps: float,
    ) -> None:
        """Integrates one step.

        Args:
            duty: Not used: no ECU drives the motor.
            powered: The motor has its supply.
            driver_torque_nm: On the shaft.
            aligning_torque_nm: Of the tyres, at the shaft.
            speed_mps: Not used: the tyres' scrub is in the motor's friction.
        """
        motor, gear = self._unit.motor, self._gear_ratio
        motor.is_supplied = powered
        motor.load_torque_nm = (driver_torque_nm + aligning_torque_nm) / gear
        before = self.rate_radps
        self._unit.run(self._step_ns)
        self.angle_rad = motor.angle_rad / gear
        self.rate_radps = motor.speed_radps / gear
        acceleration = (self.rate_radps - before) / self._dt_s
        self.accel_filtered_radps2 += self._filter_gain * (
            acceleration - self.accel_filtered_radps2
        )
        self._turn_road_wheels()


class DrivenTraction(Traction):
    """Both rear wheels on the road, each behind its motor's gear.

    A wheel drags the car by the slip of its rim, and the road drags the wheel. What the tyres
    cannot transmit does not reach the car. A drive that is told to stand holds its wheel: that is
    no drive torque, whichever way its loop overshoots.
    """

    def __init__(
        self, params: PlantParams, drives: DriveTrainParams, chassis: Chassis, train: DriveTrain
    ) -> None:
        radius_m = params.chassis.wheel_radius_m
        super().__init__(params.traction, params.step_ns, radius_m)
        self._chassis = chassis
        self._train = train
        self._step_ns = params.step_ns
        self._half_track_m = 0.5 * params.chassis.track_m
        self._gear_per_m = params.traction.gear_ratio / radius_m
        self._torque_constant = drives.wheel_motor.torque_constant_nm_per_a
        for unit in (train.left, train.right):
            unit.motor.load_damping_nm_per_radps = (
                drives.tyre_damping_n_per_mps / self._gear_per_m**2
            )

    def step(
        self, drive_ratio: float, regen_ratio: float, dead: bool, wheel_speed_mps: float
    ) -> float:
        """Integrates one step: 0 at the front wheels, the force at the rear ones in the chassis.

        Args:
            drive_ratio: Of the driver's pedal while the relay is open.
            regen_ratio: Not used: no ECU drives the motors.
            dead: The motors give no torque.
            wheel_speed_mps: Not used: the rear wheels' follow from the chassis.
        """
        chassis, train = self._chassis, self._train
        apart_mps = self._half_track_m * chassis.yaw_rate_radps
        rolling = 1.0 - chassis.rear_lock_ratio
        is_supplied = train.hardware.relay_closed and not dead
        pedal_nm = 0.0 if dead else 0.5 * drive_ratio * self._torque_nm
        force_n = self.torque_nm = self.drive_nm = 0.0
        for unit, side in ((train.left, -1.0), (train.right, 1.0)):
            motor = unit.motor
            motor.is_supplied = is_supplied
            motor.load_torque_nm = pedal_nm
            rolls = (chassis.speed_mps + side * apart_mps) * rolling * self._gear_per_m
            motor.load_speed_radps = rolls
            unit.run(self._step_ns)
            slip_nm = motor.load_damping_nm_per_radps * (motor.speed_radps - rolls)
            force_n += slip_nm * self._gear_per_m
            torque_nm = self._torque_constant * motor.current_a + pedal_nm
            self.torque_nm += torque_nm
            if torque_nm * motor.speed_radps > 0.0 and not unit.is_holding:
                self.drive_nm += abs(torque_nm)
        chassis.rear_drive_n = force_n
        return 0.0


assert round(TICK_S * NS_PER_S) == TICK_NS
