"""Every kind of fault does to a running car what its table says, and can be taken away again."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from canbus.frame import Frame
from dbc.codec import FrameFault, decode
from dbc.endpoint import ID_OF_NAME
from dbc.messages import ErrorCode, Mode, Reason
from simulation.fault_kinds import KINDS, TARGETS, FaultKind, Strikes
from simulation.faults import Fault
from simulation.injector import FULL_TORQUE_NM, Injector
from simulation.plant.state import DriverInputs, PlantFaults
from simulation.world import World, in_time
from tests.scenarios.driving import TABBY, Drive
from vehicles import load_vehicle

pytestmark = pytest.mark.whole_car

K = FaultKind
STATUS = "STEER_STATUS"
STATUS_ID = ID_OF_NAME[STATUS]
EVERYTHING = [(kind, target) for kind, spec in KINDS.items() for target in TARGETS[spec.strikes]]


def injector(world: World, seed: int = 1) -> Injector:
    return Injector(world, np.random.default_rng(seed))


BAJA = load_vehicle("baja_5b")
"""Its motors hang on drives."""


class Case:
    """A car that drives, an injector, and what was on the wire since."""

    def __init__(self, speed_mps: float = 3.0, curvature_per_m: float = 0.0) -> None:
        self.drive = Drive().go(speed_mps, curvature_per_m)
        self.world = self.drive.world
        self.injector = injector(self.world)
        self.heard: list[tuple[str, Frame]] = []
        self.world.wire.witnesses.append(
            lambda ns, sender, frame: self.heard.append((sender, frame))
        )

    def inject(self, kind: FaultKind, target: str = "", **more: float) -> Case:
        self.injector.begin(Fault(kind=kind, target=target, **more))
        return self

    def run(self, span_s: float) -> Case:
        self.drive.run(span_s)
        return self

    def frames(self, name: str) -> list[tuple[str, Frame]]:
        """Senders and frames with a message's identifier."""
        return [(sender, frame) for sender, frame in self.heard if frame.can_id == ID_OF_NAME[name]]

    def count(self, name: str = STATUS) -> int:
        return len(self.frames(name))

    @property
    def first(self) -> tuple[ErrorCode, Reason]:
        return self.drive.first_emergency()


def touched(world: World) -> dict[str, Any]:
    """Everything that a fault may change."""
    found: dict[str, Any] = {}
    for name, station in world.stations.items():
        found[name] = (
            station.is_alive, station.is_frozen, station.is_mute, station.is_deaf,
            station.step_ns, station.lateness_ns is in_time, station.clock.drift_ppm,
            len(station.tampers), len(station.senses), len(station.acts),
        )
    for unit in world.car.train.units if world.car.train is not None else ():
        found[unit.name] = unit.is_alive, unit.is_mute, unit.is_deaf, set(unit.drive._broken)
    found["wire"] = (len(world.wire.filters), len(world.wire.witnesses))
    found["car"] = asdict(world.car.faults), asdict(world.car.driver)
    return found


@pytest.mark.parametrize(("kind", "target"), EVERYTHING)
def test_every_fault_leaves_no_trace_once_healed(kind: FaultKind, target: str) -> None:
    world = World(BAJA if KINDS[kind].strikes is Strikes.DRIVE else TABBY, seed=3)
    world.run_for(0.3)
    faults = injector(world)
    before = touched(world)
    faults.begin(Fault(kind=kind, target=target))
    world.run_for(0.1)
    faults.heal()
    assert faults.active == [] and faults.planner is None
    world.run_for(0.5)  # power is back as well
    assert touched(world) == before
    assert asdict(world.car.faults) == asdict(PlantFaults())
    assert asdict(world.car.driver) == asdict(DriverInputs())


def test_a_fault_begins_and_ends_at_its_times_and_is_told() -> None:
    world = World(TABBY, seed=1)
    faults = injector(world)
    told: list[tuple[int, str, bool]] = []
    faults.listeners.append(lambda ns, fault, is_begin: told.append((ns, fault.kind, is_begin)))
    faults.plan([Fault(kind=K.MUTE, target="Steering", at_s=0.25, for_s=0.5)])
    world.run_for(0.249)
    assert faults.active == [] and told == []
    world.run_for(0.001)
    assert world.stations["Steering"].is_mute and len(faults.active) == 1
    world.run_for(0.5)
    assert not world.stations["Steering"].is_mute
    assert told == [(250_000_000, "mute", True), (750_000_000, "mute", False)]
    assert (faults.injections[0].begin_ns, faults.injections[0].end_ns) == (
        250_000_000, 750_000_000,
    )
    faults.heal()
    assert len(told) == 2


@pytest.mark.parametrize(
    ("fault", "over_s"),
    [
        (Fault(kind=K.REPLAY, target=STATUS, for_s=0.1, value=0.3), 0.4),
        (Fault(kind=K.DELAY, target=STATUS, for_s=0.1, value=50.0), 0.15),
        (Fault(kind=K.RESTART, target="Steering", value=0.2), 0.2),
        (Fault(kind=K.BROWN_OUT, value=0.25), 0.25),
        (Fault(kind=K.BUS_OFF, target="Steering"), 0.2),
        (Fault(kind=K.DROP, target=STATUS, for_s=0.1), 0.1),
    ],
)
def test_a_fault_is_over_when_all_that_it_has_set_off_is(fault: Fault, over_s: float) -> None:
    case = Case()
    begin_ns = case.world.now_ns
    told: list[tuple[int, bool]] = []
    case.injector.listeners.append(lambda ns, fault, is_begin: told.append((ns, is_begin)))
    case.injector.begin(fault)
    case.run(1.0)
    end_ns = begin_ns + round(over_s * 1e9)
    assert told == [(begin_ns, True), (end_ns, False)]
    assert case.injector.injections[0].end_ns == end_ns


def test_the_wire_asks_about_disturbances_only_while_there_are_some() -> None:
    case = Case()
    disturbers = case.world.wire.disturbers
    assert not disturbers
    case.inject(K.NOISE, for_s=0.1, share=0.1).inject(
        K.CORRUPT_ON_WIRE, STATUS, for_s=0.2, share=0.1
    )
    assert len(disturbers) == 1
    case.run(0.15)
    assert len(disturbers) == 1
    case.run(0.1)
    assert not disturbers


def test_every_corrupted_frame_is_told_beside_what_was_sent() -> None:
    case = Case()
    told: list[tuple[str, Frame, Frame]] = []
    case.injector.corruption_listeners.append(lambda *item: told.append(item))
    case.inject(K.CORRUPT_BEFORE_CRC, STATUS, for_s=0.1).run(0.2)
    assert 9 <= len(told) <= 11
    for sender, sent, heard in told:
        bits = int.from_bytes(sent.data, "little") ^ int.from_bytes(heard.data, "little")
        assert sender == "Steering" and bits.bit_count() == 1


def test_faults_of_one_thing_overlap_and_end_in_any_order() -> None:
    world = World(TABBY, seed=1)
    faults = injector(world)
    faults.plan([
        Fault(kind=K.FRICTION, at_s=0.1, for_s=0.3, value=0.3),
        Fault(kind=K.FRICTION, at_s=0.2, for_s=0.4, value=0.5),
    ])
    seen = []
    for _ in range(7):
        world.run_for(0.1)
        seen.append(world.car.faults.friction_mu)
    assert seen == [0.3, 0.5, 0.5, 0.5, 0.5, None, None]


def test_one_seed_is_one_run_and_another_seed_another() -> None:
    def run(seed: int) -> str:
        world = World(TABBY, seed=5)
        faults = injector(world, seed)
        faults.plan([Fault(kind=K.CORRUPT_BEFORE_CRC, target=STATUS, share=0.5)])
        world.run_for(1.0)
        return world.trace.sha256

    assert run(1) == run(1) != run(2)


# Messages ----------------------------------------------------------------------------------------


def test_a_dropped_message_is_never_on_the_wire_and_a_share_of_it_is() -> None:
    assert Case().inject(K.DROP, STATUS).run(0.1).count() == 0
    case = Case().inject(K.DROP, "STEER_COMMAND", share=0.3).run(1.0)
    assert 25 <= case.count("STEER_COMMAND") <= 45  # of 50


def test_a_delayed_message_comes_late_and_is_late_for_its_receivers() -> None:
    case = Case().inject(K.DELAY, STATUS, value=45.0).run(0.04)
    assert case.count() == 0
    case.run(0.1)
    assert case.count() >= 9
    assert case.drive.is_in(Mode.AUTOMATIC)


def test_a_doubled_message_is_counted_as_repeated() -> None:
    case = Case().inject(K.DUPLICATE, STATUS).run(0.1)
    assert case.count() >= 18
    supervisor = case.drive.supervisor.shell.endpoint
    assert supervisor.counts[FrameFault.REPEATED] >= 9


def test_bits_flipped_in_memory_pass_the_bus_and_fail_the_protection() -> None:
    case = Case().inject(K.CORRUPT_BEFORE_CRC, STATUS).run(0.05)
    faults = [decode(frame) for _, frame in case.frames(STATUS)]
    assert faults and all(fault is FrameFault.CRC for fault in faults)
    assert case.world.wire.error_frames == 0


def test_noise_on_a_message_is_seen_by_the_controllers_and_nothing_is_lost() -> None:
    case = Case().inject(K.CORRUPT_ON_WIRE, STATUS, share=0.2).run(1.0)
    assert case.world.wire.error_frames >= 10
    assert case.count() >= 99
    assert case.drive.is_in(Mode.AUTOMATIC)


def test_a_message_cut_short_is_ignored() -> None:
    case = Case().inject(K.TRUNCATE, STATUS).run(0.04)
    assert {len(frame.data) for _, frame in case.frames(STATUS)} == {4}
    assert case.drive.supervisor.shell.endpoint.counts[FrameFault.LENGTH] >= 3


def test_a_replayed_message_comes_from_a_stranger_bit_for_bit() -> None:
    case = Case().inject(K.REPLAY, STATUS, value=0.053).run(0.2)
    own = [frame for sender, frame in case.frames(STATUS) if sender == "Steering"]
    again = [frame for sender, frame in case.frames(STATUS) if sender == "replayer"]
    assert len(again) >= 12 and again == own[: len(again)]
    assert case.drive.is_in(Mode.EMERGENCY)  # the owner sees its own identifier


def test_a_replay_that_meets_the_original_drives_both_off_the_bus() -> None:
    """Both wait behind one frame, win the arbitration together and collide, again and again."""
    case = Case().inject(K.REPLAY, STATUS, value=0.05).run(0.2)
    assert case.world.wire.error_frames == 32
    said = [event.text for _, event in case.world.events if event.node == "Steering"]
    assert any("BUS_OFF" in text for text in said)
    assert case.drive.brakes_to_standstill()


def test_a_forged_message_is_intact_and_its_owner_objects() -> None:
    case = Case().inject(K.SPOOF, STATUS).run(0.1)
    forged = [decode(frame) for sender, frame in case.frames(STATUS) if sender == "forger"]
    assert forged and FrameFault.CRC not in forged
    assert case.first[1] in (Reason.FOREIGN_SENDER, Reason.VERDICT_BRAKE)


# Nodes -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [K.CRASH, K.FREEZE, K.MUTE, K.RESTART, K.BUS_OFF])
def test_a_node_that_falls_silent_makes_the_car_brake(kind: FaultKind) -> None:
    case = Case().inject(kind, "Throttle").run(0.1)
    assert case.count("THROTTLE_STATUS") == 0
    assert case.first in ((ErrorCode.ER2, Reason.NODE_SILENT),
                          (ErrorCode.ER1, Reason.VERDICT_BRAKE))
    assert case.drive.brakes_to_standstill()


def test_a_frozen_node_goes_on_with_what_has_come_and_admits_its_lateness() -> None:
    case = Case().inject(K.FREEZE, "Steering", for_s=0.3).run(0.6)
    said = [e.text for ns, e in case.world.events if e.node == "Steering"]
    assert any("ER2 LATE" in text for text in said)


def test_a_deaf_node_misses_the_others() -> None:
    case = Case().inject(K.DEAF, "Steering").run(0.1)
    assert case.first == (ErrorCode.ER2, Reason.SUPERVISOR_SILENT)


def test_slow_steps_are_overruns() -> None:
    case = Case().inject(K.SLOW_STEP, "Steering", value=20.0).run(0.2)
    assert case.first == (ErrorCode.ER2, Reason.OVERRUNS)


def test_jitter_below_the_limit_trips_nothing() -> None:
    case = Case()
    for name in TARGETS[Strikes.NODE]:
        case.inject(K.JITTER, name, value=4.0)
    case.run(3.0)
    assert case.drive.is_in(Mode.AUTOMATIC), case.drive.log()


def test_a_clock_that_jumps_is_a_late_node() -> None:
    case = Case().inject(K.CLOCK_JUMP, "Steering", value=100.0).run(0.1)
    assert case.first == (ErrorCode.ER2, Reason.LATE)


def test_a_clock_that_drifts_does_not_jump() -> None:
    case = Case()
    clock = case.world.stations["Steering"].clock
    before_ns = clock.local_ns(case.world.now_ns)
    case.inject(K.CLOCK_DRIFT, "Steering", value=5000.0)
    assert abs(clock.local_ns(case.world.now_ns) - before_ns) <= 1
    start_ns = case.world.now_ns
    case.run(1.0)
    passed_ns = clock.local_ns(case.world.now_ns) - before_ns
    assert passed_ns == pytest.approx((case.world.now_ns - start_ns) * 1.005, abs=2)
    assert case.drive.is_in(Mode.AUTOMATIC)


def test_bus_off_is_told_and_comes_back_unauthorised() -> None:
    case = Case().inject(K.BUS_OFF, "Steering")
    controller = case.world.wire.controllers["Steering"]
    assert not controller.is_on_bus
    case.run(0.3)
    assert controller.is_on_bus
    assert any("bus-off" in e.text.lower() or "BUS_OFF" in e.text
               for _, e in case.world.events if e.node == "Steering")
    case.run(3.0)
    assert case.drive.is_in(Mode.EMERGENCY) and abs(case.drive.speed) < 0.05


def test_a_babbling_node_repeats_its_own_frame_and_is_stopped() -> None:
    case = Case().inject(K.BABBLE, "Steering").run(0.2)
    assert case.count() > 100
    assert case.drive.is_in(Mode.EMERGENCY)


# Bus, power, planner, driver, road ---------------------------------------------------------------


def test_a_flood_with_identifier_0_shuts_everybody_out_and_all_brake_alone() -> None:
    case = Case().inject(K.FLOOD).run(0.2)
    load = [sender for sender, _ in case.heard[-100:]]
    assert set(load) == {"flooder"}
    assert case.drive.brakes_to_standstill()


def test_noise_on_a_share_of_all_frames_is_repaired_by_the_bus() -> None:
    case = Case().inject(K.NOISE, share=0.02).run(2.0)
    assert case.world.wire.error_frames > 20
    assert case.drive.is_in(Mode.AUTOMATIC), case.drive.log()


def test_noise_on_every_frame_is_a_silent_bus() -> None:
    case = Case().inject(K.NOISE).run(0.2)
    assert case.heard == []
    assert case.drive.brakes_to_standstill()


def test_a_planners_fault_is_there_for_the_pilot() -> None:
    case = Case()
    case.inject(K.PLANNER_LATE, value=90.0)
    assert case.injector.planner is not None and case.injector.planner.value == 90.0
    case.injector.heal()
    assert case.injector.planner is None


@pytest.mark.parametrize(
    ("control", "name", "value"),
    [
        ("steering", "steering_torque_nm", FULL_TORQUE_NM / 2),
        ("throttle", "throttle_pedal_ratio", 0.5),
        ("brake", "brake_pedal_ratio", 0.5),
        ("button", "button_pressed", True),
        ("emergency_stop", "emergency_stop_pressed", True),
    ],
)
def test_a_driver_grabs_any_control(control: str, name: str, value: float) -> None:
    case = Case().inject(K.DRIVER_GRABS, control, value=0.5)
    assert abs(getattr(case.world.car.driver, name)) == value
    case.run(0.2)
    assert not case.drive.is_in(Mode.AUTOMATIC)


def test_load_slope_and_friction_change_the_road() -> None:
    energy_j = Case().world.car.truth.kinetic_energy_j
    case = Case().inject(K.LOAD, value=400.0).run(0.02)
    assert case.world.car.truth.kinetic_energy_j > 1.3 * energy_j
    case.inject(K.SLOPE, value=0.2).run(1.0)
    assert case.drive.speed < 2.9
    slippery = Case(5.0).inject(K.FRICTION, value=0.1)
    slippery.inject(K.DRIVER_GRABS, "emergency_stop").run(0.5)
    assert slippery.world.car.truth.front_wheels_locked


# Readings and actuators --------------------------------------------------------------------------


def reading(case: Case, node: str, field: str) -> float:
    """What an ECU reads now."""
    station = case.world.stations[node]
    value = station.sense(case.world.now_ns)
    number: float = getattr(value, field)
    return number


ANGLE = ("Steering", "column_angle_rad")
TARGET = ".".join(ANGLE)


def test_readings_lie_as_the_fault_says() -> None:
    case = Case(3.0, 0.05)
    true_rad = reading(case, *ANGLE)
    case.inject(K.SENSOR_OFFSET, TARGET, value=0.1)
    assert reading(case, *ANGLE) == pytest.approx(true_rad + 0.925, abs=0.02)
    case.injector.heal()
    case.inject(K.SENSOR_STUCK, TARGET)
    stuck = [reading(case.run(0.02), *ANGLE) for _ in range(5)]
    assert len(set(stuck)) == 1
    case.injector.heal()
    case.inject(K.SENSOR_NOISE, TARGET, value=0.5)
    assert len({reading(case, *ANGLE) for _ in range(5)}) == 5
    case.injector.heal()
    case.inject(K.SENSOR_OUT_OF_BOUNDS, TARGET, value=1.5)
    assert reading(case, *ANGLE) == 1.5 * 9.25
    case.injector.heal()
    case.inject(K.SENSOR_NAN, TARGET)
    assert math.isnan(reading(case, *ANGLE))
    case.injector.heal()
    case.inject(K.SENSOR_SWAPPED, TARGET)
    assert abs(reading(case, *ANGLE)) < 0.5 < true_rad  # the torque: no hands on the wheel


@pytest.mark.parametrize("node", TARGETS[Strikes.ENCODER])
def test_a_dead_encoder_is_found_by_the_other_axle(node: str) -> None:
    case = Case(5.0).inject(K.ENCODER_DEAD, node).run(0.5)
    assert case.first == (ErrorCode.ER1, Reason.VERDICT_BRAKE)


def test_a_stuck_steering_motor_is_found_in_the_next_bend() -> None:
    case = Case(4.0, 0.05).inject(K.ACTUATOR_STUCK, "Steering")
    case.drive.curvature_per_m = -0.05
    case.run(1.0)
    assert case.first == (ErrorCode.ER1, Reason.VERDICT_BRAKE)


def test_a_weak_brake_servo_is_found_while_it_brakes() -> None:
    case = Case(5.0).inject(K.ACTUATOR_WEAK, "BrakeServo", value=0.3)
    case.inject(K.DRIVER_GRABS, "emergency_stop").run(0.6)
    assert 0.2 < case.drive.brake < 0.4


def test_a_slow_actuator_lags() -> None:
    fast, slow = Case(2.0), Case(2.0).inject(K.ACTUATOR_SLOW, "Throttle", value=1.0)
    for case in (fast, slow):
        case.run(2.0)  # it lags behind what it is told from now on
        case.drive.speed_mps = 5.0
        case.run(0.6)
    assert slow.drive.speed < fast.drive.speed - 0.05


def test_a_steering_motor_that_overheats_weakens_and_shuts_down_with_er4() -> None:
    case = Case(3.0).inject(K.ACTUATOR_HOT, "Steering", value=0.5).run(0.45)
    assert case.drive.is_in(Mode.AUTOMATIC)
    case.run(0.1)
    assert case.first == (ErrorCode.ER4, Reason.MOTOR_FAULT)


@pytest.mark.parametrize("node", ["Throttle", "BrakeServo"])
def test_another_actuator_that_overheats_does_nothing_any_more(node: str) -> None:
    case = Case(3.0).inject(K.ACTUATOR_HOT, node, value=0.1).run(0.2)
    if node == "BrakeServo":
        case.inject(K.DRIVER_GRABS, "emergency_stop").run(0.5)
        assert case.drive.brake < 0.05
    else:
        case.drive.speed_mps = 6.0
        case.run(1.0)
        assert case.drive.speed < 3.0
