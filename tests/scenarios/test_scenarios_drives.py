"""A car whose steering and rear wheels are motor drives on the bus: it drives, and it stops."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canbus import cia402
from canbus.cia402_power import PowerState
from canbus.frame import Frame
from dbc.messages import ErrorCode, Inhibit, Mode, NodeState, Reason, Request
from ecus.common.drive_output import START_NS
from simulation.drives.faults import DriveFault
from simulation.plant.drive_train import HELD, DriveTrain
from tests.oracle.watched import Watched
from tests.scenarios.driving import STRANGER, TICK_S, Drive
from tests.vehicles.drive_car import CAR, GEAR, LEFT, STEER, TEXT
from vehicles import parse_vehicle

pytestmark = pytest.mark.whole_car

GEAR_PER_M = CAR.traction.gear_ratio / CAR.geometry.wheel_radius_m


class DriveCar(Watched):
    """The scenarios' drive on such a car, an oracle watching."""

    def __init__(self) -> None:
        super().__init__(vehicle=CAR)

    @property
    def train(self) -> DriveTrain:
        train = self.car.train
        assert train is not None
        return train

    @property
    def drive_torque_nm(self) -> float:
        return self.car.parts.traction.drive_nm

    def age_of_emergency_ms(self, since_ns: int) -> float:
        return (self.emergencies[0][0] - since_ns) / 1e6


def driving(speed_mps: float = 1.0, curvature_per_m: float = 0.0) -> DriveCar:
    drive = DriveCar()
    drive.go(speed_mps, curvature_per_m)
    return drive


def standing() -> DriveCar:
    drive = DriveCar()
    drive.start()
    return drive


# Driving -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("radius_m", [1.6, 2.0, -1.6, -2.0])
def test_the_wheels_turn_apart_as_the_circle_wants(radius_m: float) -> None:
    drive = driving(0.4, 1 / radius_m)
    truth = drive.car.truth
    assert truth.speed_mps == pytest.approx(0.4, rel=0.02)
    assert truth.yaw_rate_radps / truth.speed_mps == pytest.approx(1 / radius_m, rel=0.02)
    left, right = (u.motor.speed_radps for u in (drive.train.left, drive.train.right))
    apart_mps = (right - left) / GEAR_PER_M
    assert apart_mps == pytest.approx(CAR.geometry.track_m * truth.yaw_rate_radps, rel=0.05)
    torques = [abs(u.motor.current_a) for u in (drive.train.left, drive.train.right)]
    assert max(torques) < 5.0  # they do not work against each other


def test_the_steering_follows_from_one_side_to_the_other() -> None:
    drive = driving(1.0, 0.5)
    for curvature_per_m in (-0.5, 0.3, 0.0):
        drive.curvature_per_m = curvature_per_m
        drive.run(1.0)
        truth = drive.car.truth
        assert truth.yaw_rate_radps / truth.speed_mps == pytest.approx(curvature_per_m, abs=0.02)


def test_a_planned_brake_meets_no_torque_of_the_wheels() -> None:
    drive = driving(2.0)
    servo = drive.world.stations["BrakeServo"]
    servo.acts.append(lambda true_ns, command: type(command)(
        servo_position_ratio=0.2, servo_powered=True
    ))
    drive.run(0.3)
    assert drive.mode is Mode.AUTOMATIC
    assert drive.brake > 0.15 and drive.drive_torque_nm == 0.0
    assert drive.train.left.drive.state not in HELD


def test_a_controlled_stop_ends_standing_in_ready() -> None:
    drive = driving(1.0)
    drive.request(Request.DISENGAGE)
    assert drive.run(4.0, until=lambda: drive.is_in(Mode.READY))
    assert abs(drive.speed) < 0.02


def test_a_clean_drive_breaks_no_property() -> None:
    drive = DriveCar()
    drive.away(1.5, 0.3)
    drive.touch(steering_torque_nm=2.0)
    drive.run(0.3)
    assert drive.is_in(Mode.MANUAL)
    drive.touch(steering_torque_nm=0.0)
    drive.run(0.5)
    report = drive.oracle.finish(drive.world.now_ns)
    assert report.violations == () and report.strangers == 0


def test_the_bus_carries_the_drives_besides_everything_else() -> None:
    drive = driving(1.0, 0.3)
    assert drive.world.wire.load_max < 0.6
    assert drive.world.wire.error_frames == 0


# Who has the motors ------------------------------------------------------------------------------


def test_a_touch_of_the_wheel_lets_every_motor_go() -> None:
    drive = driving(1.0)
    drive.car.driver.steering_torque_nm = 2.0
    drive.run(0.12)
    assert drive.is_in(Mode.MANUAL)
    drive.run(0.04)
    assert all(unit.drive.state not in HELD for unit in drive.train.units)
    drive.car.driver.throttle_pedal_ratio = 1.0
    drive.run(0.3)
    assert all(unit.motor.current_a == 0.0 for unit in drive.train.units)


def test_an_open_relay_leaves_a_drive_that_is_on_without_current() -> None:
    drive = driving(1.0)
    drive.car.faults.relay_stuck = True  # the coil's own word is not heard
    drive.train.hardware.relay_closed = False
    drive.run(0.05)
    assert drive.train.left.drive.state is PowerState.OPERATION_ENABLED
    assert all(unit.motor.current_a == 0.0 for unit in drive.train.units)


def test_an_emergency_takes_the_wheels_power_and_holds_the_steering() -> None:
    drive = driving(2.0, 0.3)
    drive.request(Request.EMERGENCY_STOP, 0.06)
    assert drive.drive_torque_nm == 0.0
    assert all(u.drive.state not in HELD for u in (drive.train.left, drive.train.right))
    assert drive.train.steering.drive.state is PowerState.OPERATION_ENABLED
    held_rad = drive.car.truth.column_angle_rad
    drive.run(0.1)
    assert drive.car.truth.column_angle_rad == pytest.approx(held_rad, abs=0.02)
    assert drive.brakes_to_standstill()
    drive.run(1.0)
    assert all(unit.drive.state not in HELD for unit in drive.train.units)
    assert drive.drive_torque_nm == 0.0


def test_a_dead_servo_is_replaced_by_the_wheels_drives() -> None:
    drive = driving(2.0)
    drive.car.faults.servo_dead = True
    drive.request(Request.EMERGENCY_STOP, 0.4)
    assert drive.train.left.drive.state is PowerState.OPERATION_ENABLED
    assert drive.brake < 0.1 and drive.drive_torque_nm == 0.0
    before = drive.speed
    drive.run(0.2)
    assert (before - drive.speed) / 0.2 > 2.0
    drive.run(1.5)
    stood_m = drive.car.truth.distance_m
    drive.run(2.0)
    assert drive.train.left.drive.state is PowerState.OPERATION_ENABLED
    assert drive.car.truth.distance_m - stood_m < 0.001


@pytest.mark.parametrize("slope_rad", [0.14, -0.14], ids=["up", "down"])
def test_a_dead_servo_on_a_hill_is_held_by_the_drives(slope_rad: float) -> None:
    drive = driving(1.0)
    drive.car.faults.slope_rad = slope_rad
    drive.car.faults.servo_dead = True
    drive.request(Request.EMERGENCY_STOP, 0.4)
    drive.run(1.5)
    lowest_mps = highest_mps = drive.speed
    for _ in range(100):
        drive.run(TICK_S)
        lowest_mps, highest_mps = min(lowest_mps, drive.speed), max(highest_mps, drive.speed)
    assert -0.02 < lowest_mps <= highest_mps < 0.02
    assert drive.is_in(Mode.EMERGENCY) and drive.brake < 0.1


def way_braked(brake: Callable[[DriveCar], None]) -> float:
    """Until the car stands, from the call on; no wheel is ever driven once it slows down."""
    drive = driving(2.2)
    began_m = drive.car.truth.distance_m
    brake(drive)
    drive.run(0.1)
    worst_nm = 0.0
    while abs(drive.speed) > 0.02:
        drive.run(TICK_S)
        worst_nm = max(worst_nm, drive.drive_torque_nm)
    assert worst_nm == 0.0
    return drive.car.truth.distance_m - began_m


def test_drives_never_push_against_the_watchdogs_brake() -> None:
    asked_m = way_braked(lambda drive: drive.request(Request.EMERGENCY_STOP, TICK_S))
    dead_m = way_braked(lambda drive: drive.stop_node("BrakeServo"))
    silence_m = 2.2 * 0.06
    assert dead_m < 1.1 * (asked_m + silence_m)


# What goes wrong ---------------------------------------------------------------------------------

Break = Callable[[DriveCar], None]


def break_steering(drive: DriveCar) -> None:
    drive.train.steering.drive.fail(DriveFault.OVERCURRENT)


def break_wheel(drive: DriveCar) -> None:
    drive.train.right.drive.fail(DriveFault.UNDERVOLTAGE)


def mute_steering(drive: DriveCar) -> None:
    drive.train.steering.is_mute = True


def kill_wheel(drive: DriveCar) -> None:
    drive.train.left.is_alive = False


def restart_steering(drive: DriveCar) -> None:
    drive.train.steering.restart()


def restart_wheel(drive: DriveCar) -> None:
    drive.train.right.restart()


def change_mode(drive: DriveCar) -> None:
    drive.train.left.drive._device.values[cia402.MODE] = cia402.OperationMode.HOMING


def command_as_stranger(can_id: int) -> Break:
    return lambda drive: drive.world.inject(Frame(can_id, bytes(6)), STRANGER)


CAUSES: dict[str, tuple[Break, ErrorCode, Reason]] = {
    "ER4 fault of the steering drive": (break_steering, ErrorCode.ER4, Reason.MOTOR_FAULT),
    "ER1 fault of a wheel's drive": (break_wheel, ErrorCode.ER1, Reason.MOTOR_FAULT),
    "ER2 mute steering drive, 60 ms": (mute_steering, ErrorCode.ER2, Reason.NODE_SILENT),
    "ER2 dead wheel drive, 60 ms": (kill_wheel, ErrorCode.ER2, Reason.NODE_SILENT),
    "ER2 restarted steering drive": (restart_steering, ErrorCode.ER2, Reason.NODE_SILENT),
    "ER2 restarted wheel drive": (restart_wheel, ErrorCode.ER2, Reason.NODE_SILENT),
    "ER2 wheel drive in another mode": (change_mode, ErrorCode.ER2, Reason.NODE_SILENT),
    "ER1 stranger commands the steering": (
        command_as_stranger(0x200 + STEER), ErrorCode.ER1, Reason.FOREIGN_SENDER
    ),
    "ER1 stranger commands a wheel": (
        command_as_stranger(0x300 + LEFT), ErrorCode.ER1, Reason.FOREIGN_SENDER
    ),
    "ER1 stranger writes a wheel's objects": (
        command_as_stranger(0x600 + LEFT), ErrorCode.ER1, Reason.FOREIGN_SENDER
    ),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_each_trouble_of_a_drive_brakes_within_100_ms_and_leaves_no_torque(cause: str) -> None:
    act, code, reason = CAUSES[cause]
    drive = driving(1.5, 0.2)
    began_ns = drive.world.now_ns
    act(drive)
    drive.run(0.12)
    assert drive.first_emergency() == (code, reason)
    assert drive.age_of_emergency_ms(began_ns) < 100.0
    drive.run(0.15)
    assert drive.is_in(Mode.EMERGENCY) and drive.drive_torque_nm == 0.0
    assert drive.brakes_to_standstill()


@pytest.mark.parametrize("cause", CAUSES)
def test_no_trouble_of_a_drive_breaks_a_property(cause: str) -> None:
    drive = DriveCar()
    drive.away(1.5, 0.2)
    drive.tell(cause)
    CAUSES[cause][0](drive)
    drive.run(2.5)
    report = drive.oracle.finish(drive.world.now_ns)
    assert report.violations == () and drive.is_in(Mode.EMERGENCY)


@pytest.mark.parametrize(
    ("name", "code"), [("steering", ErrorCode.ER4), ("left", ErrorCode.ER1)]
)
def test_a_drive_that_does_not_switch_on_is_a_motor_fault(
    name: str, code: ErrorCode, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = standing()
    drive.press_button()
    torque_off = getattr(drive.train, name).drive  # its STO input is open
    monkeypatch.setattr(torque_off, "_change", lambda event: None)
    drive.speed_mps = 1.0
    drive.engage(0.2)
    assert drive.is_in(Mode.AUTOMATIC) and not drive.emergencies
    drive.run(0.6)
    assert drive.is_in(Mode.EMERGENCY)
    assert drive.first_emergency() == (code, Reason.MOTOR_FAULT)
    drive.run(0.5)
    monkeypatch.undo()
    drive.run(1.5)
    drive.request(Request.RESET)
    assert drive.is_in(Mode.MANUAL) and not drive.codes


def test_er4_lets_the_steering_coast_even_where_the_drive_would_hold() -> None:
    drive = driving(2.0, 0.3)
    drive.train.steering.drive.fail(DriveFault.FOLLOWING_ERROR)
    drive.run(0.5)
    assert drive.first_emergency() == (ErrorCode.ER4, Reason.MOTOR_FAULT)
    assert drive.train.steering.drive.state not in HELD


@pytest.mark.parametrize(
    ("ecu", "names"), [("Steering", ["steering"]), ("Throttle", ["left", "right"])]
)
def test_an_ecu_that_dies_is_missed_by_its_drives_after_150_ms(ecu: str, names: list[str]) -> None:
    drive = driving(1.5, 0.2)
    drive.stop_node(ecu)
    drive.run(0.08)
    assert drive.is_in(Mode.EMERGENCY)
    drive.run(0.2)
    assert all(getattr(drive.train, n).drive.state is PowerState.FAULT for n in names)
    assert drive.drive_torque_nm == 0.0
    assert drive.brakes_to_standstill()


# Before and after a drive ------------------------------------------------------------------------


def test_a_drive_that_is_not_there_denies_engagement_from_a_second_on() -> None:
    drive = DriveCar()
    drive.train.right.is_alive = False
    drive.world.run_for((START_NS + 100_000_000) / 1e9)
    assert drive.codes == (ErrorCode.ER2,)
    drive.press_button()
    drive.engage()
    assert drive.is_in(Mode.READY)


def test_no_axis_drives_before_its_drive_is_ready() -> None:
    drive = standing()
    drive.press_button()
    drive.train.left.restart()
    drive.train.left.is_mute = True  # its boot-up is lost
    drive.run(0.03)
    drive.engage(0.05)
    assert drive.node_state("Throttle") is NodeState.RELEASED


def test_a_drive_that_refuses_a_setting_denies_engagement_with_er4() -> None:
    text = TEXT.replace(GEAR, GEAR.replace("20.0", "1000.0"))
    drive = Drive(vehicle=parse_vehicle(text, "wrong_gear.toml")).start()
    assert drive.codes == (ErrorCode.ER4,)  # 25000 rpm is a drive's most
    assert drive.supervisor.inhibit is Inhibit.CODE_LATCHED


def test_a_drive_that_restarts_in_manual_is_started_set_up_and_used() -> None:
    drive = standing()
    drive.train.left.restart()
    drive.run(0.3)
    assert drive.codes == (ErrorCode.ER2,)
    drive.run(2.5)
    assert not drive.codes
    drive.press_button()
    drive.engage()
    assert drive.is_in(Mode.AUTOMATIC)
    drive.speed_mps = 1.0
    drive.run(2.0)
    assert drive.speed == pytest.approx(1.0, abs=0.05)


def test_an_emergency_is_left_when_the_drives_fault_is_mended() -> None:
    drive = driving(1.0)
    break_steering(drive)
    assert drive.brakes_to_standstill()
    drive.run(2.0)
    assert drive.supervisor.inhibit is Inhibit.NODE_UNHEALTHY
    drive.train.steering.drive.mend(DriveFault.OVERCURRENT)
    drive.run(1.5)
    assert drive.is_in(Mode.EMERGENCY) and ErrorCode.ER4 in drive.codes  # nobody has reset it yet
    drive.request(Request.RESET)
    assert drive.is_in(Mode.MANUAL) and not drive.codes
    assert drive.node_state("Steering") is NodeState.RELEASED


def test_a_steering_drive_that_counts_anew_steers_to_the_same_angle() -> None:
    drive = standing()
    column_rad = drive.car.truth.column_angle_rad
    drive.train.steering.motor.angle_rad += 0.3 * 20.0  # by hand, the power off
    drive.train.steering.restart()
    drive.run(3.0)
    assert drive.car.truth.column_angle_rad == pytest.approx(column_rad + 0.3, abs=0.01)
    drive.press_button()
    drive.engage()
    assert drive.is_in(Mode.AUTOMATIC)
    drive.speed_mps = 0.5
    drive.run(2.0)
    assert drive.car.truth.column_angle_rad == pytest.approx(0.0, abs=0.02)

