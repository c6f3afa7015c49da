"""Which mode may follow which, and what it may authorise: the monitor's own rules."""

from __future__ import annotations

from itertools import product

import pytest

from dbc.messages import Mode, MonitorReason, Request
from tests.safety_monitor.monitor_bus import AUTHORISED, BRAKE, DENY, PERMIT, MonitorBus

NONE = (PERMIT, MonitorReason.NONE, 0)


# Which mode may follow which ---------------------------------------------------------------------

# Written a second time by hand: all other pairs are a breach.
LEGAL = {
    (Mode.INIT, Mode.MANUAL),
    (Mode.INIT, Mode.EMERGENCY),
    (Mode.MANUAL, Mode.READY),
    (Mode.MANUAL, Mode.INIT),
    (Mode.READY, Mode.MANUAL),
    (Mode.READY, Mode.AUTOMATIC),
    (Mode.READY, Mode.EMERGENCY),
    (Mode.READY, Mode.INIT),
    (Mode.AUTOMATIC, Mode.STOPPING),
    (Mode.AUTOMATIC, Mode.READY),
    (Mode.AUTOMATIC, Mode.MANUAL),
    (Mode.AUTOMATIC, Mode.EMERGENCY),
    (Mode.STOPPING, Mode.READY),
    (Mode.STOPPING, Mode.MANUAL),
    (Mode.STOPPING, Mode.EMERGENCY),
    (Mode.EMERGENCY, Mode.MANUAL),
} | {(mode, mode) for mode in Mode}


def in_mode(mode: Mode) -> MonitorBus:
    """A monitor that has seen this mode reached legally, with nothing to find fault with."""
    is_driving = mode in (Mode.AUTOMATIC, Mode.STOPPING)
    bus = MonitorBus().driving() if is_driving else MonitorBus()
    bus.say_mode(mode)
    bus.run(600)
    assert bus.answers[-1].told == NONE
    return bus


@pytest.mark.parametrize(("before", "after"), list(product(Mode, Mode)))
def test_every_pair_of_modes(before: Mode, after: Mode) -> None:
    bus = in_mode(before)
    bus.request(Request.ENGAGE)
    bus.tick()
    epoch = 4 if (before, after) == (Mode.EMERGENCY, Mode.MANUAL) else 3
    bus.say_mode(after, reset_epoch=epoch)
    answer = bus.tick()
    is_driving = after in (Mode.AUTOMATIC, Mode.STOPPING)
    if (before, after) in LEGAL:
        assert answer.told == NONE
    else:
        verdict = BRAKE if is_driving else DENY
        assert answer.told == (verdict, MonitorReason.MODE_RULE, 0x181)


def test_a_drive_that_nobody_asked_for_is_a_breach() -> None:
    bus = in_mode(Mode.READY)
    bus.say_mode(Mode.AUTOMATIC)
    assert bus.tick().told == (BRAKE, MonitorReason.MODE_RULE, 0x181)


@pytest.mark.parametrize("request_kind", [Request.DISENGAGE, Request.RESET, Request.NONE])
def test_only_a_request_to_engage_explains_a_drive(request_kind: Request) -> None:
    bus = in_mode(Mode.READY)
    bus.request(request_kind)
    bus.tick()
    bus.say_mode(Mode.AUTOMATIC)
    assert bus.tick().told == (BRAKE, MonitorReason.MODE_RULE, 0x181)


@pytest.mark.parametrize(("age_ms", "is_legal"), [(500, True), (510, False)])
def test_a_request_explains_a_drive_for_half_a_second(age_ms: int, is_legal: bool) -> None:
    bus = in_mode(Mode.READY)
    bus.request(Request.ENGAGE)
    bus.tick()
    bus.run(age_ms - 10)
    bus.say_mode(Mode.AUTOMATIC)
    assert (bus.tick().told == NONE) == is_legal


def test_a_drive_without_a_permit_is_a_breach() -> None:
    bus = in_mode(Mode.READY)
    bus.say("STEER_DRIVER", er2=True)
    bus.request(Request.ENGAGE)
    assert bus.run(20).told[0] is DENY
    bus.say_mode(Mode.AUTOMATIC)
    assert bus.tick().told == (BRAKE, MonitorReason.MODE_RULE, 0x181)


@pytest.mark.parametrize("epoch", [3, 4, 2])
def test_emergency_is_left_only_with_a_new_reset_epoch(epoch: int) -> None:
    bus = in_mode(Mode.EMERGENCY)
    bus.say_mode(Mode.MANUAL, reset_epoch=epoch)
    reason = MonitorReason.MODE_RULE if epoch == 3 else MonitorReason.NONE
    assert bus.tick().told[1] is reason


@pytest.mark.parametrize("mode", [Mode.AUTOMATIC, Mode.STOPPING])
@pytest.mark.parametrize(
    "values", [{"reset_epoch": 4}, {"decision_age_ms_max": 90.0}, {"decision_age_ms_max": 80.0}]
)
def test_reset_epoch_and_decision_limit_are_frozen_in_a_drive(
    mode: Mode, values: dict[str, float]
) -> None:
    bus = in_mode(mode)
    bus.say_mode(mode, **values)
    assert bus.tick().told == (BRAKE, MonitorReason.MODE_RULE, 0x181)


@pytest.mark.parametrize(
    "values", [{"reset_epoch": 4}, {"decision_age_ms_max": 90.0}, {"decision_age_ms_max": 80.0}]
)
def test_reset_epoch_and_decision_limit_may_change_when_nothing_drives(
    values: dict[str, float]
) -> None:
    bus = in_mode(Mode.MANUAL)
    bus.say_mode(Mode.MANUAL, **values)
    assert bus.tick().told == NONE


# Who may authorise what --------------------------------------------------------------------------

AXES = ("steering_authorised", "throttle_authorised", "brake_authorised")


@pytest.mark.parametrize("mode", list(Mode), ids=lambda mode: mode.name)
@pytest.mark.parametrize("given", list(product([False, True], repeat=3)))
def test_every_combination_of_authorisations(mode: Mode, given: tuple[bool, bool, bool]) -> None:
    bus = in_mode(mode)
    bus.say("SUPERVISOR_STATE", **dict(zip(AXES, given, strict=True)))
    answer = bus.tick()
    is_too_much = any(g and not may for g, may in zip(given, AUTHORISED[mode], strict=True))
    if is_too_much:
        assert mode not in (Mode.AUTOMATIC, Mode.STOPPING)
        assert answer.told == (DENY, MonitorReason.AUTHORISATION_RULE, 0x181)
    else:
        assert answer.told == NONE
