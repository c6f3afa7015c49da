"""The dashboard without sockets, browsers and clocks: what is shown, who may do what."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from dbc.messages import Inhibit, Mode
from telemetry.dashboard.access import Access, is_loopback, new_token
from telemetry.dashboard.control import DEAD_MAN_NS, NO_WISH, Action
from telemetry.dashboard.hub import CLIENTS_MAX, PLOTS_MAX, WRONG_TOKENS_MAX
from telemetry.dashboard.picture import LOG_MAX, PLOTTABLE
from telemetry.dashboard.track import GAP_NS_MAX, POINTS_MAX, Track
from tests.telemetry.dashboard_rig import STEP_NS, TOKEN, Browser, Rig
from tests.telemetry.monitored import MS, S

# What is shown ----------------------------------------------------------------------------------


def test_a_page_shows_speed_wheel_pedals_mode_and_why_not_ready() -> None:
    rig = Rig()
    rig.car.wheel_speed_radps, rig.car.wheel_rad = 10.0, 1.0
    browser = rig.browser()
    rig.run(1.0)
    shown = browser.shown()
    assert 2.5 < shown["speed_mps"] < 3.5 and shown["speed_mps"] == shown["speed_setpoint_mps"]
    assert shown["wheel_rad"] == pytest.approx(1.0, abs=0.01)
    assert shown["throttle_pedal_ratio"] == pytest.approx(0.25, abs=0.01)
    assert shown["mode"] == "MANUAL" and "button" in shown["why"]
    assert shown["heard"] and shown["silent_s"] == 0
    assert 0.1 < shown["load"] < 0.3 and 600 < shown["frames_per_s"] < 900
    present = {node["name"]: node["presence"] for node in shown["nodes"]}
    assert present["Steering"] == "alive" and present["Gateway"] == "missing"


def test_what_no_longer_comes_is_not_shown_as_if_it_did() -> None:
    rig = Rig()
    rig.car.wheel_speed_radps = 10.0
    browser = rig.browser()
    rig.run(0.5)
    rig.car.is_silent = True
    rig.run(1.0)
    shown = browser.shown()
    assert shown["speed_mps"] is None and shown["wheel_rad"] is None and shown["mode"] is None
    assert shown["codes"] is None and shown["verdict"] is None
    assert "no supervisor" in shown["why"] and 0.8 < shown["silent_s"] < 1.2
    assert all(node["presence"] == "missing" for node in shown["nodes"])


def test_before_anything_is_heard_nothing_is_claimed() -> None:
    rig = Rig()
    rig.car.is_silent = True
    browser = rig.browser()
    rig.run(0.2)
    shown = browser.shown()
    assert not shown["heard"] and shown["mode"] is None and shown["driven_m"] == 0


def test_only_what_has_changed_is_sent_and_a_late_page_gets_everything() -> None:
    rig = Rig()
    rig.car.wheel_speed_radps = 10.0
    early = rig.browser()
    rig.run(5.0)
    assert early.got[1]["anew"] and not any("anew" in message for message in early.got[2:])
    assert all("mode" not in message["news"] for message in early.got[3:])
    late = rig.browser()
    rig.run(0.1)
    assert late.shown() == early.shown()
    assert len(late.shown()["path"]) > 20


def test_a_browser_that_does_not_take_what_it_is_sent_gets_everything_anew_later() -> None:
    rig = Rig()
    rig.car.wheel_speed_radps = 10.0
    slow, quick = rig.browser(), rig.browser()
    rig.run(0.5)
    slow.is_busy = True
    before = len(slow.got)
    rig.run(2.0)
    assert len(slow.got) == before
    slow.is_busy = False
    rig.run(0.05)
    assert slow.got[-1]["anew"] and slow.shown() == quick.shown()


def test_codes_are_told_with_time_node_and_reason_and_modes_are_logged() -> None:
    rig = Rig()
    browser = rig.browser()
    rig.run(0.5)
    rig.car.mode, rig.car.inhibit, rig.car.has_er1 = Mode.EMERGENCY, Inhibit.CODE_LATCHED, True
    since_s = rig.now_ns / S
    rig.run(0.5)
    shown = browser.shown()
    assert [code["code"] for code in shown["codes"]] == ["ER1"]
    assert shown["codes"][0]["since"] == pytest.approx(since_s, abs=0.1)
    assert any(line["text"] == "mode MANUAL to EMERGENCY" for line in shown["log"])
    rig.car.has_er1 = False
    rig.run(0.5)
    assert browser.shown()["codes"] == []


def test_a_drive_ended_by_nobody_knows_whom_is_explained_in_the_log() -> None:
    rig = Rig()
    rig.car.mode, rig.car.inhibit = Mode.AUTOMATIC, Inhibit.NONE
    browser = rig.browser()
    rig.run(1.5)
    rig.car.mode = Mode.MANUAL
    rig.run(2.0)
    kinds = [line["kind"] for line in browser.shown()["log"]]
    assert kinds.count("disengagement") == 1


def test_chosen_signals_are_plotted_and_no_others() -> None:
    rig = Rig()
    rig.car.wheel_rad = 0.5
    browser = rig.browser()
    names = ["STEER_STATUS.steering_wheel_angle_rad", "BRAKE_COMMAND.position_ratio"]
    browser.say(do="plot", signals=names)
    rig.run(0.2)
    value, missing = browser.got[-1]["plots"]
    assert value == pytest.approx(0.5, abs=0.01) and missing is None
    for wrong in (["X.y"], "X", [1], list(PLOTTABLE)[: PLOTS_MAX + 1], [["a"]]):
        browser.say(do="plot", signals=wrong)
    assert len(browser.refusals) == 5
    rig.run(0.05)
    assert len(browser.got[-1]["plots"]) == 2
    browser.say(do="plot", signals=[])
    rig.run(0.05)
    assert "plots" not in browser.got[-1]


def test_memory_is_bounded_however_long_it_runs() -> None:
    rig = Rig()
    for number in range(2 * LOG_MAX):
        rig.picture.say(number, "page", "x")
    track = Track()
    for number in range(2 * POINTS_MAX):
        track.take(number * 100 * MS, 6.0, 0.0)
    assert len(rig.picture.whole()["log"]) == LOG_MAX and len(track.points) == POINTS_MAX


# Dead reckoning ---------------------------------------------------------------------------------


def test_a_circle_ends_where_it_began() -> None:
    track = Track()
    radius_m, speed_mps = 12.0, 3.0
    steps = round(math.tau * radius_m / speed_mps / 0.05)
    for number in range(steps + 1):
        track.take(1 + number * STEP_NS, speed_mps, 1 / radius_m)
    assert math.hypot(track.x_m, track.y_m) < 0.2
    assert track.driven_m == pytest.approx(math.tau * radius_m, rel=0.01)
    assert all(math.dist(a, b) < 1.0 for a, b in pairwise(track.points))
    assert min(y for _, y in track.points) > -0.1, "positive curvature turns left"


def test_what_was_driven_unseen_is_not_guessed() -> None:
    track = Track()
    track.take(1, 3.0, 0.0)
    assert not track.take(2, math.nan, 0.0)
    track.take(1 + GAP_NS_MAX + STEP_NS, 3.0, 0.0)
    assert track.x_m == 0.0
    track.take(1 + GAP_NS_MAX + 2 * STEP_NS, 3.0, 0.0)
    assert track.x_m == pytest.approx(0.15)


# Who may act ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("host", "is_own"),
    [
        ("localhost:8420", True), ("LOCALHOST", True), ("127.0.0.1:8420", True), ("[::1]:80", True),
        ("192.168.1.7:8420", True), ("car.lab:8420", True), ("evil.example", False),
        ("localhost.evil.example", False), ("127.0.0.1.evil.example", False), ("", False),
        ("evil@localhost", False), ("localhost/x", False), ("[::1", False), (" localhost", False),
        ("localhost:99999999", True),
    ],
)  # fmt: skip
def test_a_host_is_an_address_or_a_name_of_ours(host: str, is_own: bool) -> None:
    assert Access(TOKEN, frozenset({"Car.Lab"})).is_own_host(host) is is_own


@pytest.mark.parametrize(
    ("origin", "is_own"),
    [
        ("http://localhost:8420", True), ("https://localhost:8420", True),
        ("http://localhost:3000", False), ("http://127.0.0.1:8420", False), ("null", False),
        ("http://evil.example", False), ("file://localhost:8420", False), ("", False),
        ("http://localhost:8420.evil.example", False),
    ],
)  # fmt: skip
def test_a_page_of_another_origin_does_not_get_in(origin: str, is_own: bool) -> None:
    assert Access(TOKEN).is_own_origin(origin, "localhost:8420") is is_own
    assert not Access(TOKEN).is_own_origin("http://evil.example", "evil.example")


def test_tokens_are_new_long_and_compared_as_a_whole() -> None:
    assert new_token() != new_token() and len(new_token()) >= 20
    access = Access(TOKEN)
    assert access.is_token(TOKEN)
    for wrong in (TOKEN[:-1], TOKEN + "x", "", None, 7, [TOKEN], "\ud800"):
        assert not access.is_token(wrong)


def test_loopback_is_told_from_the_rest() -> None:
    assert all(map(is_loopback, ("localhost", "127.0.0.1", "127.8.0.1", "::1")))
    assert not any(map(is_loopback, ("0.0.0.0", "192.168.1.7", "car.lab", "::")))


@pytest.mark.parametrize("action", Action)
def test_without_the_token_nothing_is_done(action: Action) -> None:
    rig = Rig()
    browser = rig.browser()
    browser.say(do=action.value, brake_pedal_ratio=1.0)
    browser.say(do="show_token", token="wrong")
    browser.say(do=action.value, brake_pedal_ratio=1.0)
    assert rig.controls.done == [] and rig.controls.wishes == []
    assert len(browser.refusals) == 2 and {"control": False} in browser.got


def test_who_guesses_tokens_is_shown_the_door() -> None:
    browser = Rig().browser()
    for _ in range(WRONG_TOKENS_MAX):
        assert not browser.is_closed
        browser.say(do="show_token", token="wrong")
    assert browser.is_closed


def test_with_the_token_an_action_is_done_and_logged() -> None:
    rig = Rig()
    browser = rig.browser(with_token=True)
    for action in set(Action) - {Action.HOLD}:
        browser.say(do=action.value)
    assert set(rig.controls.done) == set(Action) - {Action.HOLD}
    rig.run(0.1)
    assert any("emergency brake asked for" in line["text"] for line in browser.shown()["log"])


def test_an_action_that_is_not_possible_here_is_refused() -> None:
    rig = Rig()
    rig.controls.actions = frozenset({Action.EMERGENCY_BRAKE})
    browser = rig.browser(with_token=True)
    assert browser.got[0]["hello"]["actions"] == ["emergency_brake"]
    browser.say(do="engage")
    browser.say(do="hold", speed_mps=1.0)
    assert rig.controls.done == [] and len(browser.refusals) == 2


def test_the_cars_own_refusal_reaches_the_page_and_the_log() -> None:
    rig = Rig()
    rig.controls.refusal = "press the button"
    browser = rig.browser(with_token=True)
    for action in ("engage", "emergency_brake", "hold"):
        browser.say(do=action)
    assert browser.refusals == ["press the button"] * 3
    rig.run(0.1)
    assert any("engage refused: press" in line["text"] for line in browser.shown()["log"])
    rig.hub.close(browser.client)
    rig.run(0.1)


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "7", '{"do": 1}', '{"do": "fly"}', '{"do": null}', b"\xff\xfe", "[" * 2000],
)
def test_nonsense_is_answered_and_harms_nothing(text: str | bytes) -> None:
    rig = Rig()
    browser = rig.browser(with_token=True)
    rig.hub.take(browser.client, text, rig.now_ns)
    assert browser.refusals == ["not understood"]
    rig.run(0.1)


def test_there_is_room_for_so_many_browsers_and_no_more() -> None:
    rig = Rig()
    browsers = [rig.browser() for _ in range(CLIENTS_MAX)]
    assert not rig.hub.open(Browser(rig).client)
    rig.hub.close(browsers[0].client)
    rig.hub.close(browsers[0].client)
    rig.browser()


# The dead-man -----------------------------------------------------------------------------------


def test_what_is_held_ends_when_the_browser_falls_silent() -> None:
    rig = Rig()
    browser = rig.browser(with_token=True)
    for _ in range(20):
        browser.say(do="hold", speed_mps=2.0)
        rig.run(0.1)
    assert rig.controls.wishes[-1].speed_mps == 2.0 and NO_WISH not in rig.controls.wishes
    rig.run(DEAD_MAN_NS / S + 0.05)
    assert rig.controls.wishes[-1] == NO_WISH
    assert any("silent" in line["text"] for line in browser.shown()["log"])


@pytest.mark.parametrize("how", ["release", "close", "wrong token"])
def test_what_is_held_ends_when_the_browser_lets_go_or_is_gone(how: str) -> None:
    rig = Rig()
    browser = rig.browser(with_token=True)
    browser.say(do="hold", brake_pedal_ratio=0.5)
    if how == "release":
        browser.say(do="release")
    elif how == "close":
        rig.hub.close(browser.client)
    else:
        browser.say(do="show_token", token="wrong")
    assert [wish.brake_pedal_ratio for wish in rig.controls.wishes] == [0.5, 0.0]


def test_one_browser_holds_at_a_time() -> None:
    rig = Rig()
    first, second = rig.browser(with_token=True), rig.browser(with_token=True)
    first.say(do="hold", speed_mps=2.0)
    second.say(do="hold", speed_mps=5.0)
    second.say(do="release")
    assert [wish.speed_mps for wish in rig.controls.wishes] == [2.0] and second.refusals
    first.say(do="release")
    second.say(do="hold", speed_mps=5.0)
    assert rig.controls.wishes[-1].speed_mps == 5.0


@pytest.mark.parametrize(
    ("given", "held"),
    [(2.0, 2.0), (99.0, 6.0), (-1.0, 0.0), (3, 3.0), (10**400, 6.0), (-math.inf, 0.0)],
)
def test_a_wish_is_cut_to_what_is_allowed(given: float, held: float) -> None:
    rig = Rig()
    rig.browser(with_token=True).say(do="hold", speed_mps=given)
    assert rig.controls.wishes[-1].speed_mps == held


@pytest.mark.parametrize("given", ["2", None, True, math.nan, [2.0]])
def test_a_wish_that_is_no_number_is_refused(given: object) -> None:
    rig = Rig()
    browser = rig.browser(with_token=True)
    browser.say(do="hold", speed_mps=given)
    assert rig.controls.wishes == [] and len(browser.refusals) == 1
