"""Modes, engaging, starting up, latching: histories made by hand."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from dbc.messages import HeartbeatState, Mode, NodeState, Request, Verdict
from oracle.engaging import TIMEOUTS_NS, EngagedInOrder, StartsUp
from oracle.latches import CodesLatched, EmergencyLatched
from oracle.modes import MAY_FOLLOW, Authorisation, ModeOrder
from oracle.words import HEARTBEATS
from tests.oracle.history import DRIVERS, History

# Order -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("after", [mode for mode in Mode if mode is not Mode.INIT])
@pytest.mark.parametrize("before", list(Mode))
def test_only_the_documented_modes_follow(before: Mode, after: Mode) -> None:
    history = History(ModeOrder)
    history.mode(before).run(100).mode(after).run(100)
    may = after == before or after.name in {m.name for m in MAY_FOLLOW[before]}  # type: ignore[index]
    assert bool(history.broken()) != may


@pytest.mark.parametrize(("gap_ms", "is_broken"), [(20, True), (30, False)])
def test_nothing_is_concluded_where_states_are_missing(gap_ms: int, is_broken: bool) -> None:
    history = History(ModeOrder).run(100).mode(Mode.STOPPING)
    state = history.says.pop("SUPERVISOR_STATE")
    history.run(gap_ms - 10)
    history.says["SUPERVISOR_STATE"] = state
    assert bool(history.run(10).broken()) == is_broken


def test_init_needs_a_restart_which_may_be_heard_a_little_later() -> None:
    for boots_after_ms, is_broken in ((-20, False), (1, False), (40, False), (None, True)):
        history = History(ModeOrder).drive()
        if boots_after_ms == -20:
            history.boot_up("SUPERVISOR_HEARTBEAT")
        history.mode(Mode.INIT).run(10)
        if boots_after_ms is not None and boots_after_ms > 0:
            history.run(boots_after_ms // 10 * 10)
            history.boot_up("SUPERVISOR_HEARTBEAT")
        assert bool(history.run(100).broken()) == is_broken, boots_after_ms


@pytest.mark.parametrize(("speed_mps", "is_broken"), [(0.15, False), (0.16, True), (-0.5, True)])
def test_ready_after_a_controlled_stop_needs_a_standstill(
    speed_mps: float, is_broken: bool
) -> None:
    history = History(ModeOrder).drive().mode(Mode.STOPPING).run(500)
    history.truth["speed_mps"] = speed_mps
    assert bool(history.run(10).mode(Mode.READY).run(10).broken()) == is_broken


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("axis", ["steering", "throttle", "brake"])
def test_an_axis_is_authorised_by_its_modes_alone(mode: Mode, axis: str) -> None:
    history = History(Authorisation).run(50).mode(mode, **{f"{axis}_authorised": True})
    is_driving = mode in (Mode.AUTOMATIC, Mode.STOPPING)
    may = is_driving or (mode is Mode.EMERGENCY and axis != "throttle")
    assert bool(history.run(50).broken()) != may


# Engaging ----------------------------------------------------------------------------------------


def test_a_drive_that_begins_as_documented_breaks_nothing() -> None:
    history = History(EngagedInOrder).drive()
    assert history.broken() == [] and history.others() == []


def engaged_after(spoil: Callable[[History], None], wait_ms: float = 0.0) -> list[str]:
    """What was missing in a READY car that is engaged so long after something was spoilt."""
    history = History(EngagedInOrder).ready()
    history.request(Request.ENGAGE)
    spoil(history)
    history.run(wait_ms)
    if wait_ms:
        history.request(Request.ENGAGE)
    return history.mode(Mode.AUTOMATIC).run(10).broken()


def silence(name: str) -> Callable[[History], None]:
    return lambda history: history.says.pop(name)


@pytest.mark.parametrize("name", TIMEOUTS_NS)
def test_a_message_that_is_missing_for_longer_than_its_timeout_is_missed(name: str) -> None:
    timeout_ms = TIMEOUTS_NS[name] // 1_000_000
    assert engaged_after(silence(name), timeout_ms - 50) == []
    assert engaged_after(silence(name), timeout_ms + 20)


@pytest.mark.parametrize("name", DRIVERS)
@pytest.mark.parametrize(
    "change",
    [{"er2": True}, {"er0": True}, {"driver_active": True}, {"node_state": NodeState.EMERGENCY},
     {"node_state": NodeState.STARTING}],
    ids=str,
)
def test_an_actuator_node_that_is_not_well_is_missed(name: str, change: dict[str, bool]) -> None:
    def spoil(history: History) -> None:
        history.change(name, **change)

    assert engaged_after(spoil, 110) == []
    (text,) = engaged_after(spoil, 130)
    assert name in text


def test_a_verdict_that_is_no_permit_is_missed() -> None:
    def spoil(history: History) -> None:
        history.change("SAFETY_VERDICT", verdict=Verdict.DENY)

    assert engaged_after(spoil, 70) == []
    assert engaged_after(spoil, 100) == ["without PERMIT"]


@pytest.mark.parametrize("name", [name for name in HEARTBEATS if name != "SUPERVISOR_HEARTBEAT"])
def test_a_node_that_is_not_operational_is_missed(name: str) -> None:
    def spoil(history: History) -> None:
        history.change(name, state=HeartbeatState.PRE_OPERATIONAL)

    (text,) = engaged_after(spoil, 50)
    assert name in text


def test_a_request_must_be_fresh() -> None:
    for age_ms, is_broken in ((90, False), (100, True)):
        history = History(EngagedInOrder).ready()
        history.request(Request.ENGAGE)
        history.run(age_ms).mode(Mode.AUTOMATIC).run(10)
        assert (history.broken() == ["without a request"]) == is_broken
    history = History(EngagedInOrder).ready()
    history.request(Request.DISENGAGE)
    assert history.mode(Mode.AUTOMATIC).run(10).broken() == ["without a request"]


def test_ready_needs_a_push_of_the_button_just_before_it() -> None:
    for late_ms, is_broken in ((100, False), (200, True)):
        history = History(EngagedInOrder).run(500)
        history.truth["button_pressed"] = True
        history.run(50 + late_ms)
        history.mode(Mode.READY).run(10)
        history.request(Request.ENGAGE)
        history.mode(Mode.AUTOMATIC).run(10)
        assert (history.broken() == ["without the button"]) == is_broken


def test_ready_after_a_controlled_stop_needs_no_new_push() -> None:
    history = History(EngagedInOrder).drive().mode(Mode.STOPPING).run(500).mode(Mode.READY)
    history.node_states(NodeState.RELEASED).run(200)
    history.request(Request.ENGAGE)
    assert history.mode(Mode.AUTOMATIC).run(10).broken() == []


def test_the_emergency_stop_must_be_released() -> None:
    def spoil(history: History) -> None:
        history.truth["emergency_stop_pressed"] = True

    assert engaged_after(spoil, 30) == []
    assert engaged_after(spoil, 50) == ["without the emergency stop released"]


# Starting up -------------------------------------------------------------------------------------


def start() -> History:
    history = History(StartsUp).mode(Mode.INIT)
    return history.change("SAFETY_VERDICT", verdict=Verdict.DENY)


@pytest.mark.parametrize(("late_ms", "is_broken"), [(1990, False), (2020, True)])
def test_manual_with_permit_must_come_within_2_s(late_ms: int, is_broken: bool) -> None:
    history = start().run(late_ms).mode(Mode.MANUAL)
    history.change("SAFETY_VERDICT", verdict=Verdict.PERMIT)
    assert bool(history.run(1000).broken()) == is_broken


def test_manual_alone_or_permit_alone_is_a_deadlock() -> None:
    assert start().mode(Mode.MANUAL).run(2100).broken() == ["MANUAL with DENY after 2000.0 ms"]
    history = start().change("SAFETY_VERDICT", verdict=Verdict.PERMIT)
    assert history.run(2100).broken() == ["INIT with PERMIT after 2000.0 ms"]


def test_a_node_that_was_never_heard_explains_it() -> None:
    history = start()
    del history.says["GATEWAY_HEARTBEAT"]
    assert history.run(5000).broken() == []


def test_faults_and_boot_ups_begin_the_time_anew() -> None:
    history = start().run(1500)
    history.fault()
    history.run(1000)
    history.fault(is_begin=False)
    history.run(1900)
    history.boot_up("STEER_HEARTBEAT")
    assert history.run(1900).broken() == []
    assert history.run(200).broken()


def test_a_restart_has_a_second_more() -> None:
    for late_ms, is_broken in ((2900, False), (3100, True)):
        history = History(StartsUp).run(500)
        history.boot_up("STEER_HEARTBEAT")
        history.change("SAFETY_VERDICT", verdict=Verdict.DENY).run(late_ms)
        assert bool(history.broken()) == is_broken


def test_a_world_that_has_started_may_deny_as_long_as_it_likes() -> None:
    history = History(StartsUp).run(500)
    assert history.change("SAFETY_VERDICT", verdict=Verdict.DENY).run(5000).broken() == []


# Latches -----------------------------------------------------------------------------------------


def reset(history: History, **state: object) -> list[str]:
    """The planner asks for a reset, and gets it."""
    history.request(Request.RESET)
    return history.mode(Mode.MANUAL, **({"reset_epoch": 1} | state)).run(50).broken()


def test_a_reset_at_standstill_that_raises_the_epoch_is_well() -> None:
    history = History(EmergencyLatched).drive().emergency().stand()
    assert history.broken() == [] and reset(history) == []


def test_the_button_resets_too() -> None:
    history = History(EmergencyLatched).drive().emergency().stand()
    history.look(button_pressed=True)
    history.run(40)
    assert history.mode(Mode.MANUAL, reset_epoch=1).run(50).broken() == []


@pytest.mark.parametrize("epoch", [0, 2, 15])
def test_an_epoch_that_is_not_raised_by_one_is_told(epoch: int) -> None:
    history = History(EmergencyLatched).drive().emergency().stand()
    assert reset(history, reset_epoch=epoch) == [f"EMERGENCY -> MANUAL: epoch 0 -> {epoch}"]


def test_the_epoch_wraps() -> None:
    history = History(EmergencyLatched)
    history.change("SUPERVISOR_STATE", reset_epoch=15)
    history.drive().emergency().stand()
    assert reset(history, reset_epoch=0) == []


def test_a_reset_of_a_moving_car_is_told() -> None:
    history = History(EmergencyLatched).drive().emergency().stand()
    history.truth["speed_mps"] = 0.2
    history.run(10)
    assert reset(history) == ["EMERGENCY -> MANUAL: at 0.20 m/s"]


def test_a_reset_that_nobody_asked_for_is_told() -> None:
    history = History(EmergencyLatched).drive().emergency().stand()
    history.request(Request.RESET)
    history.run(200)
    told = history.mode(Mode.MANUAL, reset_epoch=1).run(50).broken()
    assert told == ["EMERGENCY -> MANUAL: nobody asked"]


@pytest.mark.parametrize("mode", [Mode.READY, Mode.AUTOMATIC, Mode.STOPPING])
def test_an_emergency_that_ends_elsewhere_is_told(mode: Mode) -> None:
    history = History(EmergencyLatched).drive().emergency().stand()
    history.request(Request.RESET)
    (text,) = history.mode(mode, reset_epoch=1).run(50).broken()
    assert "not to MANUAL" in text


def test_a_restarted_supervisor_must_find_the_emergency_again() -> None:
    nodes = ("STEER_HEARTBEAT", "THROTTLE_HEARTBEAT", "BRAKE_HEARTBEAT")
    for rebooted, is_broken in (((), True), (nodes[:2], True), (nodes, False)):
        history = History(EmergencyLatched).drive().emergency().stand()
        for name in ("SUPERVISOR_HEARTBEAT", *rebooted):
            history.boot_up(name)
        history.mode(Mode.INIT).run(500).mode(Mode.MANUAL, reset_epoch=0).run(50)
        assert bool(history.broken()) == is_broken


def with_code() -> History:
    """A car in an emergency whose steer ECU has latched ER4."""
    history = History(CodesLatched).drive()
    history.change("STEER_DRIVER", er4=True)
    return history.run(20).emergency()


def test_a_code_that_clears_by_itself_is_told() -> None:
    history = with_code().run(3000)
    assert history.broken() == []
    history.change("STEER_DRIVER", er4=False)
    assert history.run(10).broken() == ["Steering no longer tells ER4, epoch 0"]


def test_a_code_that_clears_with_the_epoch_is_well() -> None:
    history = with_code().stand()
    history.mode(Mode.MANUAL, reset_epoch=1).run(20)
    history.change("STEER_DRIVER", er4=False).node_states(NodeState.RELEASED)
    assert history.run(2000).broken() == []


def test_a_node_that_restarts_forgets_its_codes() -> None:
    history = with_code()
    history.boot_up("STEER_HEARTBEAT")
    history.change("STEER_DRIVER", er4=False, node_state=NodeState.STARTING)
    assert history.run(2000).broken() == []


def test_er0_and_codes_under_a_human_are_not_latched() -> None:
    history = History(CodesLatched).drive()
    history.change("BRAKE_DRIVER", er0=True).run(50).change("BRAKE_DRIVER", er0=False)
    history.change("THROTTLE_DRIVER", er2=True, node_state=NodeState.RELEASED).run(50)
    history.node_states(NodeState.EMERGENCY).run(50).change("THROTTLE_DRIVER", er2=False)
    assert history.run(100).broken() == []
