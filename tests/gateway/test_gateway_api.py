"""`Car` in virtual time: the real gateway core, a scripted rest of the car."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from dbc.messages import Inhibit, Mode, Request
from gateway.api import Car
from gateway.commands import CommandError
from gateway.errors import (
    DisengageFailed,
    EngageRefused,
    LinkFailed,
    NotConnected,
    ResetRefused,
)
from gateway.kinematics import Kinematics
from tests.gateway.scripted import MS, TABBY, Rig, RigLink, Sent, named, obedient_supervisor

KIN = Kinematics.of(TABBY.geometry, TABBY.steering)


def make(react: Any = obedient_supervisor) -> tuple[Car, RigLink, Rig]:
    rig = Rig()
    rig.react = react
    link = RigLink(rig)
    return Car(link), link, rig


def requests(rig: Rig) -> list[Request]:
    return [item.content.request for item in named(rig.sent, "MODE_REQUEST")]


def test_ten_lines_drive_the_car() -> None:
    car, link, rig = make()
    with car:
        car.engage()
        for tick, state in enumerate(car.ticks()):
            assert state.is_engaged
            car.command(speed_mps=3.0, curvature_per_m=0.02)
            if tick == 50:
                break
        ages = [c.content.decision_age_ms for c in named(rig.sent, "STEER_COMMAND")]
        assert max(age for age in ages if not math.isnan(age)) == 0
        link.on_cycle = lambda: rig.mode(Mode.READY)
        car.disengage()
        assert car.state.mode is Mode.READY
    assert link.calls == ["open", "close"]


def test_nothing_is_opened_before_the_with_block() -> None:
    _, link, _ = make()
    assert link.calls == []


@pytest.mark.parametrize(
    "call",
    [
        lambda car: car.engage(),
        lambda car: car.command(speed_mps=1.0, curvature_per_m=0.0),
        lambda car: car.cmd_vel(speed_mps=1.0, yaw_rate_radps=0.0),
        lambda car: car.car_command(left_mps=1.0, right_mps=1.0, ackermann_rad=0.0),
        lambda car: car.state,
        lambda car: car.ticks(),
        lambda car: car.disengage(),
        lambda car: car.emergency_brake(),
        lambda car: car.reset(),
    ],
)
def test_every_call_outside_the_with_block_is_refused(call: Any) -> None:
    car, _, rig = make()
    with pytest.raises(NotConnected, match="inside its with block"):
        call(car)
    with car:
        rig.sent.clear()
    with pytest.raises(NotConnected):
        call(car)
    assert rig.sent == []


def test_car_is_entered_once() -> None:
    car, _, _ = make()
    with car, pytest.raises(NotConnected, match="call connect"):
        car.__enter__()


def test_car_that_cannot_be_opened_stays_closed() -> None:
    car, link, _ = make()
    link.open = lambda: (_ for _ in ()).throw(OSError("no bus"))  # type: ignore[method-assign]
    with pytest.raises(OSError, match="no bus"), car:
        pytest.fail("never entered")
    with pytest.raises(NotConnected):
        _ = car.state


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({"speed_mps": math.nan, "curvature_per_m": 0.0}, CommandError),
        ({"speed_mps": 1.0, "curvature_per_m": 0.2}, CommandError),
        ({"speed_mps": "fast", "curvature_per_m": 0.0}, TypeError),
        ({"speed_mps": 1.0, "curvature_per_m": None}, TypeError),
        ({"speed_mps": 1.0, "curvature_per_m": 0.0, "age_s": -0.001}, CommandError),
        ({"speed_mps": 1.0, "curvature_per_m": 0.0, "age_s": math.nan}, CommandError),
    ],
)
def test_wrong_command_raises_at_once_and_sends_nothing(
    values: dict[str, Any], error: type[Exception]
) -> None:
    car, _, rig = make()
    with car:
        rig.sent.clear()
        with pytest.raises(error):
            car.command(**values)
        assert rig.sent == []
        assert math.isnan(car.state.decision_age_s)


def test_a_decision_may_have_been_made_before_it_was_given() -> None:
    car, link, _ = make()
    with car:
        car.command(speed_mps=1.0, curvature_per_m=0.0, age_s=0.03)
        link.wait_until(link.now_ns() + 20_000_000)
        assert car.state.decision_age_s == pytest.approx(0.05, abs=0.011)


def test_cmd_vel_and_car_command_leave_as_one_speed_and_one_angle() -> None:
    car, link, rig = make()
    with car:
        car.engage()
        wheels = KIN.rear_wheel_speeds_mps(3.0, 0.05)
        commands: tuple[Callable[[], None], ...] = (
            lambda: car.command(speed_mps=3.0, curvature_per_m=0.05),
            lambda: car.cmd_vel(speed_mps=3.0, yaw_rate_radps=0.15),
            lambda: car.car_command(
                left_mps=wheels.left_mps,
                right_mps=wheels.right_mps,
                ackermann_rad=KIN.road_wheel_angle_rad(0.05),
            ),
        )
        angles, speeds = [], []
        for command in commands:
            rig.sent.clear()
            command()
            link.wait_until(link.now_ns() + 100_000_000)
            angles.append(
                named(rig.sent, "STEER_COMMAND")[0].content.steering_wheel_angle_rad
            )
            speeds.append(named(rig.sent, "THROTTLE_COMMAND")[0].content.wheel_speed_radps)
        assert angles[0] == pytest.approx(KIN.steering_wheel_angle_rad(0.05), abs=0.001)
        assert angles == [angles[0]] * 3
        assert speeds == [speeds[0]] * 3
        link.on_cycle = lambda: rig.mode(Mode.READY)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda car: car.cmd_vel(speed_mps=0.0, yaw_rate_radps=0.1), CommandError),
        (lambda car: car.cmd_vel(speed_mps=1.0, yaw_rate_radps="left"), TypeError),
        (
            lambda car: car.car_command(left_mps=1.0, right_mps=2.0, ackermann_rad=0.0),
            CommandError,
        ),
    ],
)
def test_wrong_cmd_vel_or_car_command_sends_nothing(call: Any, error: type[Exception]) -> None:
    car, _, rig = make()
    with car:
        rig.sent.clear()
        with pytest.raises(error):
            call(car)
        assert rig.sent == []


@pytest.mark.parametrize("timeout_s", [-1.0, math.nan, math.inf, 1e9])
def test_timeout_out_of_range_is_named(timeout_s: float) -> None:
    car, _, rig = make()
    with car:
        for call in (car.engage, car.disengage, car.reset):
            with pytest.raises(CommandError, match=r"timeout_s = .*allowed 0 to 3600 s"):
                call(timeout_s=timeout_s)
        assert requests(rig) == []


@pytest.mark.parametrize("period_s", [0.0, -1.0, math.nan, 11.0])
def test_tick_period_out_of_range_is_named_at_the_call(period_s: float) -> None:
    car, _, _ = make()
    with car, pytest.raises(CommandError, match=r"period_s = .*allowed 0\.001 to 10 s"):
        car.ticks(period_s)


def test_engage_when_engaged_asks_for_nothing() -> None:
    car, _, rig = make()
    with car:
        rig.mode(Mode.AUTOMATIC)
        rig.run(20)
        car.engage()
        assert requests(rig) == []
        rig.mode(Mode.MANUAL)
        rig.run(20)


def test_engage_asks_again_until_somebody_presses_the_button() -> None:
    car, link, rig = make()
    with car:
        rig.mode(Mode.MANUAL, inhibit=Inhibit.PRESS_BUTTON)
        rig.run(20)
        start_ns = rig.now_ns

        def press() -> None:
            if rig.now_ns - start_ns > 3000 * MS and rig.state().mode is Mode.MANUAL:
                rig.mode(Mode.READY, inhibit=Inhibit.NOT_REQUESTED)

        link.on_cycle = press
        car.engage(timeout_s=5.0)
        assert car.state.is_engaged
        assert {item.content.sequence for item in named(rig.sent, "MODE_REQUEST")} == {1, 2}
        link.on_cycle = lambda: rig.mode(Mode.MANUAL)


def test_refused_engagement_says_why_and_asks_no_longer() -> None:
    car, _, rig = make(react=lambda rig, sent: None)
    with car:
        rig.mode(Mode.MANUAL, inhibit=Inhibit.MISSING_STEERING)
        start_ns = rig.now_ns
        with pytest.raises(EngageRefused, match="the steering ECU is not heard"):
            car.engage(timeout_s=1.0)
        assert 1000 * MS <= rig.now_ns - start_ns <= 1100 * MS
        rig.sent.clear()
        rig.run(3000)
        assert requests(rig) == []


def test_engagement_that_came_while_giving_up_counts() -> None:
    def late(rig: Rig, sent: Sent) -> None:
        if sent.name == "MODE_REQUEST" and sent.time_ns - start_ns >= 90 * MS:
            rig.mode(Mode.AUTOMATIC)

    car, link, rig = make(react=late)
    with car:
        start_ns = rig.now_ns
        car.engage(timeout_s=0.1)
        assert car.state.is_engaged
        rig.react = obedient_supervisor
        link.on_cycle = lambda: rig.mode(Mode.READY)


def test_interrupted_engagement_is_withdrawn() -> None:
    car, link, rig = make(react=lambda rig, sent: None)

    def interrupt() -> None:
        raise KeyboardInterrupt

    with car:
        link.on_cycle = interrupt
        with pytest.raises(KeyboardInterrupt):
            car.engage()
        assert rig.state().pending_request is Request.NONE


def test_disengage_while_moving_waits_for_the_controlled_stop() -> None:
    car, link, rig = make()
    with car:
        car.engage()
        start_ns = rig.now_ns

        def stand() -> None:
            if rig.now_ns - start_ns > 4000 * MS:
                rig.mode(Mode.READY)

        link.on_cycle = stand
        car.disengage()
        assert rig.now_ns - start_ns >= 4000 * MS
        assert car.state.mode is Mode.READY
        assert rig.state().pending_request is Request.NONE


def test_disengage_without_an_answer_fails_with_the_mode() -> None:
    car, link, rig = make(react=lambda rig, sent: None)
    with car:
        rig.mode(Mode.AUTOMATIC)
        rig.run(20)
        with pytest.raises(DisengageFailed, match=r"^mode AUTOMATIC after 0\.5 s$"):
            car.disengage(timeout_s=0.5)
        rig.muted.add("Supervisor")
        rig.run(100)
        with pytest.raises(DisengageFailed, match=r"mode unknown after 0\.5 s: no supervisor"):
            car.disengage(timeout_s=0.5)
        assert link.calls == ["open"]


def test_disengage_that_ends_in_an_emergency_says_so_at_once() -> None:
    car, link, rig = make()
    with car:
        car.engage()
        link.on_cycle = lambda: rig.mode(Mode.EMERGENCY, inhibit=Inhibit.MOVING)
        with pytest.raises(DisengageFailed, match="emergency brake: the car is moving"):
            car.disengage()


def test_emergency_brake_returns_at_once_and_reset_ends_it() -> None:
    car, _, rig = make()
    with car:
        car.engage()
        before_ns = rig.now_ns
        car.emergency_brake()
        assert rig.now_ns == before_ns
        assert len(named(rig.sent, "FAILSAFE")) == 1
        rig.run(50)
        assert car.state.why_not_engaged.startswith("emergency brake (Gateway: the planner asked")
        car.reset()
        assert car.state.mode is Mode.MANUAL


def test_refused_reset_says_why() -> None:
    car, _, rig = make(react=lambda rig, sent: None)
    with car:
        rig.mode(Mode.EMERGENCY, inhibit=Inhibit.MOVING)
        with pytest.raises(ResetRefused, match="the car is moving"):
            car.reset()
        assert {item.content.sequence for item in named(rig.sent, "MODE_REQUEST")} == {1, 2}
        assert rig.state().pending_request is Request.NONE


def test_reset_while_engaged_is_refused_in_words() -> None:
    car, link, rig = make(react=lambda rig, sent: None)
    with car:
        rig.mode(Mode.AUTOMATIC)
        rig.run(20)
        with pytest.raises(ResetRefused, match="disengage"):
            car.reset(timeout_s=0.1)
        link.on_cycle = lambda: rig.mode(Mode.READY)


def test_reset_without_a_supervisor_is_refused() -> None:
    car, _, rig = make(react=lambda rig, sent: None)
    rig.muted.add("Supervisor")
    with car, pytest.raises(ResetRefused, match="no supervisor on the bus"):
        car.reset(timeout_s=0.2)


def test_interrupted_reset_is_withdrawn() -> None:
    car, link, rig = make(react=lambda rig, sent: None)

    def interrupt() -> None:
        raise KeyboardInterrupt

    with car:
        link.on_cycle = interrupt
        with pytest.raises(KeyboardInterrupt):
            car.reset()
        assert rig.state().pending_request is Request.NONE


def test_leaving_the_block_while_automatic_is_a_controlled_stop() -> None:
    car, link, rig = make()
    with car:
        car.engage()
        rig.sent.clear()
        link.on_cycle = lambda: rig.mode(Mode.READY) if rig.now_ns > 3000 * MS else None
    assert set(requests(rig)) == {Request.DISENGAGE}
    assert rig.now_ns > 3000 * MS
    assert link.calls == ["open", "close"]


def test_leaving_the_block_by_an_error_stops_the_car_and_keeps_the_error() -> None:
    car, link, rig = make()
    with pytest.raises(ZeroDivisionError), car:
        car.engage()
        link.on_cycle = lambda: rig.mode(Mode.READY)
        raise ZeroDivisionError
    assert Request.DISENGAGE in requests(rig)
    assert link.calls == ["open", "close"]


def test_leaving_the_block_closes_in_bounded_time_when_nobody_answers() -> None:
    car, link, rig = make()
    with car:
        car.engage()
        rig.react = lambda rig, sent: None
        left_ns = rig.now_ns
    # 7.5 m/s at 0.25 x 7.0 m/s2 is 4.29 s, and 2 s
    assert rig.now_ns - left_ns == pytest.approx(6.29e9, abs=0.05e9)
    assert link.calls == ["open", "close"]


def test_leaving_the_block_while_not_driving_asks_for_nothing() -> None:
    car, _, rig = make()
    with car:
        pass
    assert requests(rig) == []


def test_closing_early_ends_at_once_and_leaving_is_quiet() -> None:
    car, link, rig = make()
    with car:
        car.engage()
        now_ns = rig.now_ns
        car.close()
        car.close()
        assert rig.now_ns == now_ns
    assert set(link.calls[1:]) == {"close"}


def test_broken_link_surfaces_when_the_block_is_left() -> None:
    car, link, _ = make()
    with pytest.raises(LinkFailed, match="bus gone"), car:
        link.failure = LinkFailed("bus gone")
    assert link.calls == ["open", "close"]


def test_broken_link_does_not_hide_the_first_error() -> None:
    car, link, _ = make()
    with pytest.raises(ZeroDivisionError) as raised, car:
        link.failure = LinkFailed("bus gone")
        raise ZeroDivisionError
    assert raised.value.__context__ is None
    assert link.calls == ["open", "close"]


def test_ticks_keep_absolute_deadlines() -> None:
    car, _, rig = make()
    with car:
        start_ns = rig.now_ns
        times_ms = []
        for state in car.ticks():
            times_ms.append((state.time_ns - start_ns) / MS)
            rig.now_ns += 7 * MS  # the body's own time
            if len(times_ms) == 5:
                break
        assert times_ms == [0, 20, 40, 60, 80]
        assert car.missed_ticks == 0


def test_missed_ticks_are_skipped_and_counted_and_the_newest_comes_at_once() -> None:
    car, _, rig = make()
    with car:
        start_ns = rig.now_ns
        times_ms = []
        for state in car.ticks(0.05):
            times_ms.append((state.time_ns - start_ns) / MS)
            if len(times_ms) == 2:
                rig.now_ns += 170 * MS  # from 50 to 220: 100 and 150 are missed, 200 is late
            if len(times_ms) == 4:
                break
        assert times_ms == [0, 50, 220, 250]
        assert car.missed_ticks == 2


def test_ticks_end_when_the_car_is_closed() -> None:
    car, _, _ = make()
    with car:
        count = 0
        for _ in car.ticks():
            count += 1
            if count == 3:
                car.close()
        assert count == 3


def test_vehicle_and_its_limits_are_at_hand() -> None:
    car, _, rig = make()
    assert car.vehicle is rig.core.vehicle
