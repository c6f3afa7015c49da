"""The steering's zero from a straight roll: found within what is stated, or refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import SteerStatus, ThrottleStatus
from telemetry.databases import load_databases
from telemetry.decode.tables import Decoded, Decoder
from telemetry.logs.frames import ChannelNames, FrameFlag, LogFrame, columns_of
from telemetry.steering_zero import (
    CalibrationError,
    Roll,
    Zero,
    check_usable,
    combined,
    roll_of,
    zero_of,
)
from vehicles import Vehicle, load_vehicle

TABBY = load_vehicle("tabby_evo")
HEADING_RAD = math.radians(0.5)
NOT_A_NUMBER = math.nan


def frames_of(
    angles_rad: list[float], speeds_mps: list[float], period_ns: int = 10_000_000
) -> list[LogFrame]:
    """A reading of each every 10 ms, the speed a little before the angle."""
    found = []
    for n, (angle, speed) in enumerate(zip(angles_rad, speeds_mps, strict=True)):
        radps = speed / TABBY.geometry.wheel_radius_m
        messages = (
            ("THROTTLE_STATUS", ThrottleStatus(
                wheel_speed_radps=radps, applied_wheel_speed_radps=NOT_A_NUMBER)),
            ("STEER_STATUS", SteerStatus(
                steering_wheel_angle_rad=angle, applied_steering_wheel_angle_rad=NOT_A_NUMBER)),
        )  # fmt: skip
        for place, (name, message) in enumerate(messages):
            frame = encode(SPEC_OF_NAME[name], message, n % 15)
            time_ns = n * period_ns + place * 300_000
            found.append(LogFrame(time_ns, "can0", frame.can_id, FrameFlag(0), 8, frame.data))
    return found


def decoded(frames: list[LogFrame]) -> Decoded:
    columns = columns_of(frames, range(1, len(frames) + 1), ChannelNames())
    return Decoder(load_databases(())).decode(columns)


def roll(angles_rad: list[float], speeds_mps: list[float]) -> Roll:
    return roll_of(decoded(frames_of(angles_rad, speeds_mps)), TABBY)


def refused(frames: list[LogFrame]) -> str:
    with pytest.raises(CalibrationError) as caught:
        zero_of(roll_of(decoded(frames), TABBY), TABBY, HEADING_RAD)
    return str(caught.value)


STEADY = frames_of([0.1] * 1000, [4.0] * 1000)


def test_a_sensor_that_reads_a_tenth_straight_ahead_is_found_after_forty_metres() -> None:
    zero = zero_of(roll([0.1] * 1001, [4.0] * 1001), TABBY, HEADING_RAD)
    assert zero.zero_rad == pytest.approx(0.1, abs=0.0005)
    assert zero.way_m == pytest.approx(40.0, rel=0.001)
    # 95 %: twice 40 * 2.36 m * 0.5 deg / 40 m
    assert zero.uncertainty_rad == pytest.approx(2.0 * 40.0 * 2.36 * HEADING_RAD / 40.0, rel=0.01)


def test_a_lane_change_does_not_disturb_it_for_the_car_points_ahead_again() -> None:
    """Left and right by the same turn, at another speed: a mean over time would be wrong."""
    angles = [0.05 + 1.0] * 200 + [0.05 - 1.0] * 400 + [0.05] * 1000
    speeds = [4.0] * 200 + [2.0] * 400 + [4.0] * 1000
    zero = zero_of(roll(angles, speeds), TABBY, HEADING_RAD)
    assert zero.zero_rad == pytest.approx(0.05, abs=0.001)
    assert abs(float(np.mean(angles)) - 0.05) > 0.1


def test_the_zero_in_force_is_added_to_what_is_left_of_it() -> None:
    vehicle = replace(TABBY, steering=replace(TABBY.steering, zero_rad=0.02))
    zero = zero_of(roll([0.1] * 1000, [4.0] * 1000), vehicle, HEADING_RAD)
    assert zero.zero_rad == pytest.approx(0.12, abs=0.0005)


def test_a_roll_backwards_gives_the_same_zero() -> None:
    assert zero_of(roll([0.1] * 1000, [-4.0] * 1000), TABBY, HEADING_RAD).zero_rad == (
        pytest.approx(0.1, abs=0.0005)
    )


def test_there_and_back_on_the_same_spot_says_nothing() -> None:
    angles, speeds = [0.1] * 1001, [4.0] * 500 + [-4.0] * 501
    assert refused(frames_of(angles, speeds)).startswith("the car did not roll: 0.00 m")


@pytest.mark.parametrize("speed_mps", [0.0, 0.05])
def test_a_car_that_stands_is_refused(speed_mps: float) -> None:
    told = refused(frames_of([0.1] * 1000, [speed_mps] * 1000))
    assert told.startswith("the car did not roll") and "2.36 m" in told


def without(name: str, first: int, last: int) -> list[LogFrame]:
    """The steady roll, a message's frames missing in a span of its readings."""
    can_id = SPEC_OF_NAME[name].can_id
    own = [n for n, frame in enumerate(STEADY) if frame.can_id == can_id]
    gone = set(own[first:last])
    return [frame for n, frame in enumerate(STEADY) if n not in gone]


@pytest.mark.parametrize("name", ["STEER_STATUS", "THROTTLE_STATUS"])
def test_a_log_without_the_message_is_refused(name: str) -> None:
    assert refused(without(name, 0, 1000)) == f"no frame of {name}: is it the vehicle bus?"


@pytest.mark.parametrize("name", ["STEER_STATUS", "THROTTLE_STATUS"])
def test_a_silence_of_more_than_100_ms_is_refused_and_a_shorter_one_is_not(name: str) -> None:
    assert "while the car rolled" in refused(without(name, 500, 511))
    zero = zero_of(roll_of(decoded(without(name, 500, 508)), TABBY), TABBY, HEADING_RAD)
    assert zero.zero_rad == pytest.approx(0.1, abs=0.0005)


@pytest.mark.parametrize(
    ("angle_rad", "speed_mps"), [(NOT_A_NUMBER, 4.0), (0.1, NOT_A_NUMBER)]
)
def test_a_value_that_was_not_available_is_refused(angle_rad: float, speed_mps: float) -> None:
    frames = frames_of([0.1] * 500 + [angle_rad] * 5 + [0.1] * 495, [4.0] * 500 + [
        speed_mps] * 5 + [4.0] * 495)  # fmt: skip
    assert "was not available while the car rolled" in refused(frames)


def test_a_car_that_does_not_know_its_speed_yet_is_not_rolling() -> None:
    speeds = [NOT_A_NUMBER] * 5 + [4.0] * 995
    zero = zero_of(roll_of(decoded(frames_of([0.1] * 1000, speeds)), TABBY), TABBY, HEADING_RAD)
    assert zero.zero_rad == pytest.approx(0.1, abs=0.0005)


def test_a_single_reading_is_refused() -> None:
    assert "less than two readings" in refused(frames_of([0.1], [4.0]))


def test_frames_with_a_wrong_crc_are_left_out() -> None:
    broken = list(STEADY)
    for n in range(101, 1900, 20):
        frame = broken[n]
        broken[n] = frame._replace(data=bytes([frame.data[0] ^ 1]) + frame.data[1:6] + b"\x22\x22")
    told = zero_of(roll_of(decoded(broken), TABBY), TABBY, HEADING_RAD)
    assert told.zero_rad == pytest.approx(0.1, abs=0.0005)


def zero(value: float, uncertainty: float = 0.01, way_m: float = 50.0) -> Zero:
    return Zero(zero_rad=value, uncertainty_rad=uncertainty, way_m=way_m)


def test_there_and_back_the_crossfall_cancels() -> None:
    both = combined([zero(0.03), zero(0.01)])
    assert both.zero_rad == pytest.approx(0.02) and both.way_m == 100.0
    assert both.uncertainty_rad == pytest.approx(0.01 / math.sqrt(2.0))


def test_the_roll_that_is_known_better_counts_for_more() -> None:
    assert combined([zero(0.03, 0.01), zero(0.0, 0.02)]).zero_rad == pytest.approx(0.024)


def test_rolls_that_contradict_each_other_are_refused() -> None:
    combined([zero(0.0), zero(0.039)])
    with pytest.raises(CalibrationError, match="contradict each other"):
        combined([zero(0.0), zero(0.041)])


def check(vehicle: Vehicle, value: Zero) -> str:
    with pytest.raises(CalibrationError) as caught:
        check_usable(value, vehicle)
    return str(caught.value)


def test_a_zero_known_worse_than_a_tenth_of_a_degree_of_road_wheel_is_refused() -> None:
    limit_rad = 40.0 * math.radians(0.1)  # 0.0698 rad
    check_usable(zero(0.01, limit_rad - 1e-6), TABBY)
    told = check(TABBY, zero(0.01, 2.0 * limit_rad, way_m=10.0))
    assert "wanted 0.0698 rad" in told and "roll 20 m" in told


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_more_than_a_tenth_of_the_range_is_no_zero(sign: float) -> None:
    check_usable(zero(sign * 0.924), TABBY)  # of 9.25 rad
    assert "is no zero" in check(TABBY, zero(sign * 0.926))
