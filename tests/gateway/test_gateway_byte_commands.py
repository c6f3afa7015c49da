"""UWA's byte commands: the frames alone, and a planner of bytes on the simulated bus."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from canbus.frame import Frame, FrameKind, ReceivedFrame
from dbc.byte_commands import SPECS
from dbc.database import BYTE_COMMANDS_DBC, load
from dbc.messages import ErrorCode, Mode
from gateway.adapters.byte_commands import ByteCommands, ByteOutput, serve
from gateway.api import Car
from gateway.commands import CommandError
from gateway.state import CarState
from simulation.link import SimulationLink
from simulation.wire import Receiver
from simulation.world import World
from vehicles import load_vehicle, parse_vehicle

pytestmark = pytest.mark.whole_car

UWA = load_vehicle("fsae_electric")
MS = 1_000_000
PERIOD_NS = 50 * MS
LIMIT_MS = 130
"""1.5 x 50 ms + 2 x 20 ms + 15 ms (design, time budget)."""
BRAKE, ACCELERATE, STEER = 0x410, 0x411, 0x412
DBC = load(BYTE_COMMANDS_DBC)


def standing(**changes: object) -> CarState:
    """A car as the gateway knows it after an engagement."""
    world = World(UWA, 0, planner_period_ns=PERIOD_NS)
    world.run_for(0.3)
    state = replace(
        SimulationLink(world).state(), is_engaged=True, mode=Mode.AUTOMATIC, speed_mps=0.0
    )
    return replace(state, **changes)  # type: ignore[arg-type]


STANDING = standing()


class Bench:
    """The adapter alone."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.car = STANDING
        self.commands = ByteCommands(UWA, PERIOD_NS)

    def step(self, *frames: Frame, after_ms: int = 10) -> ByteOutput:
        self.now_ns += after_ms * MS
        received = [ReceivedFrame(self.now_ns, frame) for frame in frames]
        return self.commands.step(self.now_ns, received, self.car)

    def give(self, brake: int, accelerate: int, steer: int, after_ms: int = 50) -> ByteOutput:
        return self.step(*byte_frames(brake, accelerate, steer), after_ms=after_ms)


def byte_frames(brake: int, accelerate: int, steer: int) -> list[Frame]:
    """As cantools makes them of the DBC."""
    values = {"BYTE_BRAKE": brake, "BYTE_ACCELERATE": accelerate, "BYTE_STEER": steer}
    frames = []
    for name, value in values.items():
        message = DBC.get_message_by_name(name)
        data = message.encode({message.signals[0].name: value}, strict=True)
        frames.append(Frame(message.frame_id, data))
    return frames


def commands_only(output: ByteOutput) -> list[Frame]:
    return [frame for frame in output.frames if frame.can_id != 0x423]


def errors(output: ByteOutput) -> set[str]:
    """Names of the bits set in the last BYTE_ERRORS."""
    (frame,) = [frame for frame in output.frames if frame.can_id == 0x423]
    decoded = DBC.decode_message(frame.can_id, frame.data)
    assert isinstance(decoded, dict)
    return {str(name) for name, is_set in decoded.items() if is_set}


@pytest.mark.parametrize("values", [(0, 0, -128), (255, 255, 127), (1, 2, -1)])
def test_every_command_comes_back_as_it_was(values: tuple[int, int, int]) -> None:
    output = Bench().give(*values)
    frames = byte_frames(*values)
    assert commands_only(output) == [Frame(frame.can_id + 0x10, frame.data) for frame in frames]


def test_the_commands_have_the_ranges_of_table_1() -> None:
    ranges = {
        message.name: (message.signals[0].minimum, message.signals[0].maximum)
        for message in DBC.messages if message.frame_id <= STEER
    }  # fmt: skip
    assert ranges == {
        "BYTE_BRAKE": (0, 255), "BYTE_ACCELERATE": (0, 255), "BYTE_STEER": (-128, 127),
    }  # fmt: skip


@pytest.mark.parametrize(
    "frame",
    [
        Frame(STEER, b""),
        Frame(STEER, b"\x05\x00"),
        Frame(BRAKE, bytes(8)),
        Frame(ACCELERATE, b"", FrameKind.REMOTE),
        Frame(ACCELERATE, b"\x05", FrameKind.FD),
    ],
)
def test_a_command_of_wrong_length_or_kind_is_ignored_and_told_for_a_second(frame: Frame) -> None:
    bench = Bench()
    output = bench.step(frame)
    assert commands_only(output) == [] and output.decision is None
    assert errors(output) == {"er0", "is_engaged"}
    others = [one for one in byte_frames(0, 0, 0) if one.can_id != frame.can_id]
    assert bench.step(*others).decision is None, "the set is not whole"
    assert errors(bench.step(after_ms=900)) == {"er0", "is_engaged"}
    assert errors(bench.step(after_ms=200)) == {"is_engaged"}


def test_other_frames_are_left_alone() -> None:
    strangers = [
        Frame(0x413, b"\x01"), Frame(0x420, b"\x01"), Frame(STEER, b"\x01", FrameKind.EXTENDED),
        Frame(STEER, bytes(8), FrameKind.ERROR), Frame(0x181, bytes(8)),
    ]  # fmt: skip
    output = Bench().step(*strangers)
    assert commands_only(output) == [] and errors(output) == {"is_engaged"}


def test_a_decision_needs_all_three_and_each_counts_once() -> None:
    bench = Bench()
    brake, accelerate, steer = byte_frames(0, 0, 10)
    assert bench.step(brake).decision is None
    assert bench.step(accelerate).decision is None
    assert bench.step(steer).decision is not None
    assert bench.step(steer, steer).decision is None
    assert bench.step(brake).decision is None
    assert bench.step(accelerate).decision is not None


def test_a_command_older_than_a_silent_planner_may_be_is_forgotten() -> None:
    bench = Bench()
    brake, accelerate, steer = byte_frames(0, 0, 0)
    bench.step(brake)
    assert bench.step(accelerate, steer, after_ms=LIMIT_MS).decision is not None
    bench.step(brake)
    assert bench.step(accelerate, steer, after_ms=LIMIT_MS + 1).decision is None


@pytest.mark.parametrize("steer", [-128, -64, 0, 64, 127])
def test_steer_is_a_share_of_the_wheels_range_positive_left(steer: int) -> None:
    decision = Bench().give(0, 0, steer).decision
    assert decision is not None
    road_rad = steer / 128 * UWA.steering.wheel_angle_rad_max / UWA.steering.ratio
    curvature_per_m = math.tan(road_rad) / UWA.geometry.wheelbase_m
    assert decision.curvature_per_m == pytest.approx(curvature_per_m)


def speeds(bench: Bench, brake: int, accelerate: int, sets: int) -> list[float]:
    found = []
    for _ in range(sets):
        decision = bench.give(brake, accelerate, 0).decision
        assert decision is not None
        found.append(decision.speed_mps)
    return found


def test_accelerate_is_a_share_of_the_vehicles_acceleration() -> None:
    full, half = Bench(), Bench()
    assert speeds(full, 0, 255, 3) == pytest.approx([0.0, 0.05 * 1.5, 0.1 * 1.5])
    assert speeds(half, 0, 51, 3) == pytest.approx([0.0, 0.01 * 1.5, 0.02 * 1.5])


def test_the_setpoint_runs_no_further_ahead_than_a_metre_per_second_nor_beyond_the_limit() -> None:
    bench = Bench()
    assert speeds(bench, 0, 255, 60)[-1] == 1.0
    bench.car = standing(speed_mps=7.4)
    assert speeds(bench, 0, 255, 200)[-1] == UWA.traction.speed_mps_max


@pytest.mark.parametrize(("brake", "mps2"), [(255, 5.5), (51, 1.1), (0, 0.15)])
def test_brake_wins_over_accelerate_and_without_both_the_car_rolls_out(
    brake: int, mps2: float
) -> None:
    bench = Bench()
    bench.car = standing(speed_mps=5.0, is_engaged=False)
    speeds(bench, 0, 0, 1)
    bench.car = standing(speed_mps=5.0)
    first, second = speeds(bench, brake, 200 if brake else 0, 2)
    assert first == pytest.approx(5.0 - 0.05 * mps2)
    assert second == pytest.approx(5.0 - 0.10 * mps2)
    assert speeds(bench, 255, 0, 30)[-1] == 0.0


@pytest.mark.parametrize("speed_mps", [math.nan, 9.0, math.inf])
def test_a_speed_that_is_not_known_lets_the_setpoint_only_begin(speed_mps: float) -> None:
    bench = Bench()
    bench.car = standing(speed_mps=speed_mps)
    assert max(speeds(bench, 0, 255, 60)) <= 1.0


def test_the_button_and_a_set_without_accelerate_ask_for_automatic() -> None:
    bench = Bench()
    bench.car = standing(mode=Mode.READY, is_engaged=False)
    assert not bench.give(0, 0, 0).wants_engage, "nobody has seen the button"
    bench.car = standing(mode=Mode.MANUAL, is_engaged=False)
    bench.step()
    bench.car = standing(mode=Mode.READY, is_engaged=False)
    assert not bench.give(0, 1, 0).wants_engage
    assert bench.give(255, 0, 0).wants_engage
    assert not bench.step().wants_engage
    bench.car = standing(mode=Mode.MANUAL, is_engaged=False)
    assert not bench.give(0, 0, 0).wants_engage


@pytest.mark.parametrize("mode", [Mode.AUTOMATIC, Mode.STOPPING, Mode.EMERGENCY])
def test_a_ready_that_ends_a_drive_is_not_the_buttons(mode: Mode) -> None:
    bench = Bench()
    for seen, wants in ((Mode.MANUAL, False), (Mode.READY, True), (mode, False),
                        (Mode.READY, False), (Mode.MANUAL, False), (Mode.READY, True)):  # fmt: skip
        bench.car = standing(mode=seen, is_engaged=False)
        assert bench.give(0, 0, 0).wants_engage is wants, seen


def test_a_decision_is_as_old_as_its_oldest_byte() -> None:
    bench = Bench()
    brake, accelerate, steer = byte_frames(0, 0, 0)
    bench.step(steer)
    assert bench.step(brake, accelerate, after_ms=40).age_s == pytest.approx(0.04)
    assert bench.step(brake, accelerate, steer).age_s == 0.0


def test_errors_are_told_every_100_ms_and_at_once_on_a_change() -> None:
    bench = Bench()
    counts = [len(bench.step().frames) for _ in range(21)]
    assert [n for n, count in enumerate(counts) if count] == [0, 10, 20]
    bench.car = standing(codes=(ErrorCode.ER5,), is_engaged=False)
    assert errors(bench.step()) == {"er5"}


def test_a_supervisor_that_is_not_heard_is_no_good_health() -> None:
    bench = Bench()
    bench.car = standing(codes=None, is_engaged=False)
    assert errors(bench.step()) == {"er2"}


def test_a_vehicle_whose_foreign_range_has_no_room_is_refused() -> None:
    text = re.sub(r"foreign_id_max = { value = 0x4FF", "foreign_id_max = { value = 0x41F", UWA.text)
    with pytest.raises(CommandError, match=r"0x410 to 0x423 within .* to foreign_id_max 0x41F"):
        ByteCommands(parse_vehicle(text, "mine.toml"), PERIOD_NS)


def test_every_identifier_lies_in_the_range_for_other_peoples_nodes() -> None:
    assert all(0x400 <= can_id <= 0x4FF for can_id in SPECS)


# On the simulated bus ------------------------------------------------------------------------


class BytePlanner:
    """A planner of bytes on the wire, the adapter beside the gateway, and the whole car."""

    def __init__(self) -> None:
        self.world = World(UWA, 3, planner_period_ns=PERIOD_NS)
        self.values = (0, 0, 0)
        self.is_silent = False
        self.heard: list[Frame] = []
        self.refusals: set[str] = set()
        self._adapter = Receiver("ByteAdapter")
        self._planner = Receiver("BytePlanner")
        for station in (self._adapter, self._planner):
            self.world.wire.attach(station)
        self._commands = ByteCommands(UWA, PERIOD_NS)
        self._clock = self.world.stations["Gateway"].clock
        self._due_ns = 0

    def run(self, car: Car, span_s: float) -> CarState:
        world = self.world
        end_ns = world.now_ns + round(span_s * 1e9)
        while world.now_ns < end_ns:
            if world.now_ns >= self._due_ns and not self.is_silent:
                self._due_ns = world.now_ns + PERIOD_NS
                world.wire.send(world.now_ns, "BytePlanner", byte_frames(*self.values))
            world.run_for(0.01)
            received = self._clock.received(self._adapter.inbox)
            self._adapter.inbox = []
            refusal = serve(
                self._commands, car, self._clock.local_ns(world.now_ns), received,
                lambda frame: world.wire.send(world.now_ns, "ByteAdapter", [frame]),
            )  # fmt: skip
            self.refusals |= {refusal} - {""}
            self.heard += [frame for _, frame in self._planner.inbox]
            self._planner.inbox = []
        return car.state

    def press(self, car: Car) -> None:
        self.world.car.driver.button_pressed = True
        self.run(car, 0.15)
        self.world.car.driver.button_pressed = False


def engaged() -> tuple[BytePlanner, Car]:
    planner = BytePlanner()
    car = Car(SimulationLink(planner.world))
    car.__enter__()
    planner.run(car, 1.0)
    planner.press(car)
    assert planner.run(car, 0.5).is_engaged, car.state.why_not_engaged
    return planner, car


def test_a_planner_of_bytes_drives_turns_and_stops_the_car() -> None:
    planner, car = engaged()
    planner.values = (0, 255, 0)
    planner.run(car, 3.0)
    planner.values = (0, 0, 40)
    state = planner.run(car, 1.5)
    assert state.is_engaged and state.speed_mps > 2.5
    assert state.steering_wheel_angle_rad == pytest.approx(40 / 128 * 2.0, abs=0.06)
    planner.values = (255, 255, 0)
    state = planner.run(car, 3.5)
    assert state.is_engaged and abs(state.speed_mps) < 0.05
    echoes = {frame for frame in planner.heard if frame.can_id == 0x421}
    assert {frame.data for frame in echoes} == {b"\x00", b"\xff"}
    assert planner.refusals == set()


def test_a_planner_of_bytes_that_falls_silent_brakes_the_car_within_the_limit() -> None:
    planner, car = engaged()
    planner.values = (0, 200, 0)
    assert planner.run(car, 2.0).speed_mps > 1.0
    planner.is_silent = True
    planner.run(car, LIMIT_MS / 1e3 + 0.1)
    state = car.state
    assert state.mode is Mode.EMERGENCY and state.codes is not None
    assert ErrorCode.ER5 in state.codes
    planner.run(car, 0.4)
    assert planner.world.car.truth.servo_position_ratio > 0.99
    told = [frame for frame in planner.heard if frame.can_id == 0x423][-1]
    assert told.data[0] & 1 << 5 and not told.data[0] & 1 << 7


def test_a_planner_that_leaves_one_command_away_falls_silent() -> None:
    planner, car = engaged()
    planner.values = (0, 200, 0)
    planner.run(car, 2.0)
    planner.is_silent = True
    for _ in range(8):
        planner.world.wire.send(planner.world.now_ns, "BytePlanner", byte_frames(0, 200, 0)[:2])
        planner.run(car, 0.05)
    assert car.state.mode is Mode.EMERGENCY


def test_a_car_stopped_by_the_button_stays_ready() -> None:
    planner, car = engaged()
    planner.values = (0, 200, 0)
    assert planner.run(car, 2.0).speed_mps > 1.0
    planner.values = (0, 0, 0)
    planner.press(car)
    assert planner.run(car, 4.0).mode is Mode.READY
    planner.press(car)  # to MANUAL
    planner.run(car, 0.5)
    planner.press(car)
    assert planner.run(car, 0.5).is_engaged


def test_spoilt_commands_beside_good_ones_change_nothing_but_are_told() -> None:
    planner, car = engaged()
    planner.values = (0, 100, 0)
    planner.run(car, 0.5)
    for _ in range(10):
        planner.world.wire.send(planner.world.now_ns, "BytePlanner", [Frame(STEER, b"\x7f\x7f")])
        planner.run(car, 0.05)
    state = car.state
    assert state.is_engaged and abs(state.steering_wheel_angle_rad) < 0.06
    assert [frame for frame in planner.heard if frame.can_id == 0x423][-1].data[0] & 1


def test_bytes_move_nothing_before_the_button() -> None:
    planner = BytePlanner()
    car = Car(SimulationLink(planner.world))
    planner.values = (0, 255, 100)
    car.__enter__()
    state = planner.run(car, 2.0)
    assert state.mode is Mode.MANUAL and planner.world.car.truth.distance_m < 0.01
    planner.press(car)
    assert planner.run(car, 1.0).mode is Mode.READY, "Accelerate must be 0 first"


def test_a_refusal_is_told_in_words() -> None:
    planner = BytePlanner()
    car = Car(SimulationLink(planner.world))
    car.__enter__()
    planner.values = (0, 1, 0)
    planner.run(car, 1.0)
    planner.press(car)
    planner.world.stations["SafetyMonitor"].is_mute = True
    planner.run(car, 0.1)
    planner.values = (0, 0, 0)
    assert not planner.run(car, 0.5).is_engaged
    assert planner.refusals and all("monitor" in text for text in planner.refusals)
