"""The plant's end of the harness: commands act when they arrive, stalls pause the world."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame, FrameKind, ReceivedFrame
from dbc.harness import (
    BrakeActuatorWire,
    DriverHandsWire,
    RelayCoil,
    SteeringActuatorWire,
    SupervisorActuatorWire,
    ThrottleActuatorWire,
)
from ecus.throttle.ports import dac_code
from runtime.harness import SPEC_OF_NAME, decode_harness, harness_frame
from runtime.plant_process import PlantSide, build_car, run_plant, truth_frames
from tests.runtime.runtime_fakes import MS, FakeBus, FakeClock, StopAt
from tests.vehicles.drive_car import CAR, LEFT
from vehicles import load_vehicle

START_NS = 7_000 * MS
HANDS: dict[str, Any] = {
    "steering_torque_nm": 0.0,
    "throttle_pedal_ratio": 0.0,
    "brake_pedal_ratio": 0.0,
    "button_pressed": False,
    "emergency_stop_pressed": False,
}


def plant() -> PlantSide:
    vehicle = load_vehicle("tabby_evo")
    return PlantSide(build_car(vehicle, seed=1, start_ns=START_NS), START_NS)


def wire(arrival_ns: int, name: str, message: object) -> ReceivedFrame:
    return ReceivedFrame(arrival_ns, harness_frame(name, message))


def relay(arrival_ns: int, coil: RelayCoil) -> ReceivedFrame:
    return wire(arrival_ns, "SUPERVISOR_ACTUATOR", SupervisorActuatorWire(relay_coil=coil))


def contents(frames: list[Frame]) -> dict[str, Any]:
    name_of = {spec.can_id: name for name, spec in SPEC_OF_NAME.items()}
    found = {}
    for frame in frames:
        reading = decode_harness(ReceivedFrame(0, frame))
        assert reading is not None
        found[name_of[frame.can_id]] = reading.content
    return found


def drive_cycles(side: PlantSide, begin_ns: int, cycles: int, *frames: Frame) -> int:
    """Runs the plant at 10 ms, the frames arriving 5 ms before each cycle; answers the time."""
    now_ns = begin_ns
    for _ in range(cycles):
        now_ns += 10 * MS
        side.step(now_ns, [ReceivedFrame(now_ns - 5 * MS, frame) for frame in frames])
    return now_ns


def test_every_sensor_is_sent_in_every_cycle() -> None:
    found = contents(plant().step(START_NS + 10 * MS, []))
    assert {name for name in found if name.endswith(("SENSORS", "ENCODER"))} == {
        "STEERING_SENSORS",
        "THROTTLE_SENSORS",
        "BRAKE_ENCODER",
        "BRAKE_SENSORS",
        "SUPERVISOR_SENSORS",
    }


def test_true_pose_is_sent_in_every_second_cycle() -> None:
    side = plant()
    sent = [contents(side.step(START_NS + n * 10 * MS, [])) for n in range(1, 5)]
    assert ["PLANT_POSITION" in found for found in sent] == [True, False, True, False]
    assert ["PLANT_MOTION" in found for found in sent] == [True, False, True, False]


def test_hands_of_the_driver_reach_pedals_and_panel() -> None:
    side = plant()
    hands = DriverHandsWire(**{**HANDS, "throttle_pedal_ratio": 0.5, "button_pressed": True})
    found = contents(side.step(START_NS + 10 * MS, [wire(START_NS + MS, "DRIVER_HANDS", hands)]))
    assert found["THROTTLE_SENSORS"].pedal_ratio == pytest.approx(0.5, abs=0.01)
    assert found["SUPERVISOR_SENSORS"].button_pressed
    assert not found["SUPERVISOR_SENSORS"].emergency_stop_pressed


def test_a_safety_circuit_is_on_the_harness_as_the_emergency_stop_line() -> None:
    """UWA's car has them; no ECU sends anything here."""
    for name, is_raised in (("fsae_electric", True), ("tabby_evo", False)):
        side = PlantSide(build_car(load_vehicle(name), seed=1, start_ns=START_NS), START_NS)
        hands = DriverHandsWire(**{**HANDS, "brake_pedal_ratio": 0.5})
        side.step(START_NS + 10 * MS, [relay(START_NS + MS, RelayCoil.CLOSE)])
        actuator = harness_frame(
            "BRAKE_ACTUATOR", BrakeActuatorWire(servo_position_ratio=0.0, servo_powered=True)
        )
        now_ns = drive_cycles(
            side, START_NS + 10 * MS, 13, harness_frame("DRIVER_HANDS", hands), actuator
        )
        found = contents(side.step(now_ns + 10 * MS, []))
        assert found["SUPERVISOR_SENSORS"].emergency_stop_pressed is is_raised


def test_driver_drives_with_the_relay_open() -> None:
    side = plant()
    hands = DriverHandsWire(**{**HANDS, "throttle_pedal_ratio": 0.5})
    drive_cycles(side, START_NS, 150, harness_frame("DRIVER_HANDS", hands))
    assert side.truth.speed_mps > 0.3


def test_relays_contact_is_sent_as_the_relay_stands() -> None:
    side = plant()
    for number, coil in enumerate((RelayCoil.CLOSE, RelayCoil.LEAVE, RelayCoil.OPEN)):
        begin_ns = START_NS + 10 * number * MS
        found = contents(side.step(begin_ns + 10 * MS, [relay(begin_ns + MS, coil)]))
        is_closed = found["SUPERVISOR_SENSORS"].automatic_relay_closed
        assert is_closed is (coil is not RelayCoil.OPEN)


def test_relay_closes_stays_and_opens() -> None:
    side = plant()
    side.step(START_NS + 10 * MS, [relay(START_NS + MS, RelayCoil.CLOSE)])
    assert side.truth.relay_closed
    side.step(START_NS + 20 * MS, [relay(START_NS + 11 * MS, RelayCoil.LEAVE)])
    assert side.truth.relay_closed
    side.step(START_NS + 30 * MS, [relay(START_NS + 21 * MS, RelayCoil.OPEN)])
    assert not side.truth.relay_closed


def test_commands_move_motor_traction_and_servo_when_the_relay_is_closed() -> None:
    side = plant()
    side.step(START_NS + 10 * MS, [relay(START_NS + MS, RelayCoil.CLOSE)])
    now_ns = drive_cycles(
        side,
        START_NS + 10 * MS,
        100,
        harness_frame(
            "STEERING_ACTUATOR", SteeringActuatorWire(motor_duty_ratio=0.8, motor_enabled=True)
        ),
        harness_frame(
            "THROTTLE_ACTUATOR",
            ThrottleActuatorWire(
                throttle_dac_code=dac_code(0.5),
                regen_dac_code=dac_code(0.0),
                reverse_selected=False,
            ),
        ),
        harness_frame(
            "BRAKE_ACTUATOR", BrakeActuatorWire(servo_position_ratio=0.0, servo_powered=False)
        ),
    )
    assert side.truth.speed_mps > 0.2
    assert side.truth.column_angle_rad > 0.2
    assert side.truth.servo_position_ratio == 0.0
    brake = BrakeActuatorWire(servo_position_ratio=0.5, servo_powered=True)
    drive_cycles(side, now_ns, 50, harness_frame("BRAKE_ACTUATOR", brake))
    assert side.truth.servo_position_ratio == pytest.approx(0.5, abs=0.05)


def test_silence_of_the_brake_ecu_lets_the_watchdog_brake() -> None:
    side = plant()
    side.step(START_NS + 10 * MS, [relay(START_NS + MS, RelayCoil.CLOSE)])
    drive_cycles(side, START_NS + 10 * MS, 50)
    assert side.truth.servo_position_ratio == pytest.approx(1.0, abs=0.01)


def test_a_stalled_plant_does_not_starve_the_watchdogs() -> None:
    side = plant()
    release = BrakeActuatorWire(servo_position_ratio=0.0, servo_powered=False)
    frame = harness_frame("BRAKE_ACTUATOR", release)
    side.step(START_NS + 10 * MS, [relay(START_NS + MS, RelayCoil.CLOSE)])
    now_ns = drive_cycles(side, START_NS + 10 * MS, 100, frame)
    assert side.truth.servo_position_ratio == 0.0
    side.step(now_ns + 400 * MS, [ReceivedFrame(now_ns + 400 * MS, frame)])
    drive_cycles(side, now_ns + 400 * MS, 5, frame)
    assert side.truth.servo_position_ratio == 0.0
    assert side.stalled_ns == 380 * MS
    assert side.truth.time_ns == now_ns + 400 * MS + 50 * MS - 380 * MS


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x104, bytes(2)),
        Frame(0x104, bytes([0x11, 0x27, 1])),  # 1.0001 of the servo's travel
        Frame(0x101, bytes([3])),  # no such pulse
        Frame(0x102, bytes(3), FrameKind.FD),
    ],
)
def test_a_bad_frame_is_counted_and_moves_nothing(frame: Frame) -> None:
    side, twin = plant(), plant()
    frames = side.step(START_NS + 10 * MS, [ReceivedFrame(START_NS + MS, frame)])
    assert side.bad_frames == 1
    assert frames == twin.step(START_NS + 10 * MS, [])


def test_frames_of_the_sensors_are_not_for_the_plant() -> None:
    side = plant()
    own = plant().step(START_NS + 10 * MS, [])
    side.step(START_NS + 10 * MS, [ReceivedFrame(START_NS + MS, frame) for frame in own])
    assert side.bad_frames == 0


def test_heading_is_sent_within_half_a_turn() -> None:
    side = plant()
    truth = side.truth
    turned = replace(truth, pose=replace(truth.pose, heading_rad=9.0 * math.tau + 0.5))
    assert contents(truth_frames(turned))["PLANT_MOTION"].heading_rad == pytest.approx(0.5)


def test_plant_runs_on_the_grid_and_publishes_the_truth() -> None:
    clock = FakeClock(START_NS)
    bus = FakeBus(clock)
    seen: list[int] = []
    alive: list[int] = []
    result = run_plant(
        plant(),
        bus,
        clock,
        StopAt(clock, START_NS + 45 * MS),
        lambda event: None,
        lambda truth: seen.append(truth.time_ns),
        alive.append,
    )
    assert alive == seen  # every cycle is a sign of life
    assert seen == [START_NS + n * 10 * MS for n in (1, 2, 3, 4)]
    assert result.exit_code == 0 and result.steps == 4
    assert {time_ns for time_ns, _ in bus.sent} == set(seen)


def test_the_motor_drives_of_a_car_are_on_the_vehicle_bus() -> None:
    side = PlantSide(build_car(CAR, seed=1, start_ns=START_NS), START_NS)
    assert 0x311 not in plant().drive_acceptance and 0x300 + LEFT in side.drive_acceptance
    clock = FakeClock(START_NS)
    start = nmt_frame(NmtCommand.START, LEFT)
    vehicle_bus = FakeBus(clock, [(START_NS + 12 * MS, start)])
    result = run_plant(
        side, FakeBus(clock), clock, StopAt(clock, START_NS + 45 * MS), lambda event: None,
        vehicle_bus=vehicle_bus,
    )  # fmt: skip
    assert result.exit_code == 0
    sent = [((time_ns - START_NS) // MS, frame.can_id) for time_ns, frame in vehicle_bus.sent]
    assert [entry for entry in sent if entry[0] == 10] == [
        (10, 0x700 + node_id) for node_id in CAR.drive_node_ids
    ]
    assert {can_id for time_ms, can_id in sent if time_ms > 10} == {0x180 + LEFT, 0x280 + LEFT}


def test_a_car_without_drives_has_nothing_on_the_vehicle_bus() -> None:
    side = plant()
    side.hear_vehicle_bus([ReceivedFrame(START_NS, nmt_frame(NmtCommand.START, 0))])
    side.step(START_NS + 10 * MS, [])
    assert side.drive_acceptance == frozenset() and side.drive_frames() == []


def test_a_vehicle_without_a_plant_of_its_own_gets_one_of_its_size() -> None:
    tabby = load_vehicle("tabby_evo")
    lorry = replace(tabby, name="lorry", geometry=replace(tabby.geometry, mass_kg=8800.0))
    speeds_mps = []
    for vehicle in (tabby, lorry):
        car = build_car(vehicle, seed=1)
        car.driver.throttle_pedal_ratio = 0.5
        car.advance(1000 * MS)
        speeds_mps.append(car.truth.speed_mps)
    assert speeds_mps[0] > 0.5 and 0.0 < speeds_mps[1] < 0.15 * speeds_mps[0]
