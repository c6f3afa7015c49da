"""`dbw dashboard` beside the stack on vcan0: what the page shows and what it may do."""

from __future__ import annotations

from pathlib import Path

import pytest

import dbw.dashboard_server  # noqa: F401, before the forks
from canbus.node import NODE_IDS
from dbc.messages import Mode
from gateway.sentences import ONLY_THE_BUTTON
from tests.telemetry.page_socket import Page
from tests.vcan.bus_log import HARNESS_BUS
from tests.vcan.forked import ForkedDbw, said_by_dbw
from tests.vcan.stack import MOVING_MPS, PLANNER, VEHICLE_BUS, Stack

BESIDE = [
    "dashboard", "--port", "0", "--channel", VEHICLE_BUS, "--harness-channel", HARNESS_BUS,
]  # fmt: skip
SHOWN_S_MAX = 3.0
STOP_S_MAX = 10.0


def all_are_alive(page: Page) -> bool:
    """Whether the page shows every node, and each as it should be."""
    return [node["presence"] for node in page.shown["nodes"]] == ["alive"] * len(NODE_IDS)


def test_the_page_beside_a_planner_shows_the_drive_has_the_button_and_stops_the_car(
    parked: Stack, tmp_path: Path
) -> None:
    with Page(BESIDE, tmp_path / "dashboard.txt", ForkedDbw) as page:
        page.until(lambda: page.shown.get("why") == ONLY_THE_BUTTON, SHOWN_S_MAX)
        assert page.shown["mode"] == "MANUAL" and page.shown["verdict"] == "PERMIT"
        page.until(lambda: all_are_alive(page), SHOWN_S_MAX)
        page.say("engage")
        page.until(lambda: "not possible from this dashboard" in page.refused, SHOWN_S_MAX)
        page.say("button")
        page.until(lambda: page.shown["mode"] == "READY", SHOWN_S_MAX)
        assert parked.planner.attempt("engage", timeout_s=3.0) is None
        parked.planner.go(3.0)
        page.until(lambda: (page.shown["speed_mps"] or 0.0) > MOVING_MPS, STOP_S_MAX)
        assert page.shown["mode"] == "AUTOMATIC"
        assert page.shown["speed_mps"] == pytest.approx(parked.truth().speed_mps, rel=0.2)
        page.say("emergency_brake")
        page.until(lambda: page.shown["mode"] == "EMERGENCY", SHOWN_S_MAX)
        page.until(lambda: page.shown["speed_mps"] == 0.0, STOP_S_MAX)
        assert [code["code"] for code in page.shown["codes"]] == ["ER1"]
        page.until(lambda: any("fail-safe command" in text for text in page.log), SHOWN_S_MAX)
    parked.brakes()


def test_a_second_gateway_is_refused(parked: Stack, tmp_path: Path) -> None:
    code, out, errors = said_by_dbw(*BESIDE, "--gateway", folder=tmp_path)
    assert code == 2 and not out
    assert f"another gateway is on {VEHICLE_BUS}" in errors
    assert parked.planner.state().mode is Mode.MANUAL


def test_the_page_drives_the_car_where_no_planner_is(parked: Stack, tmp_path: Path) -> None:
    parked.kill(PLANNER)
    with Page([*BESIDE, "--gateway"], tmp_path / "dashboard.txt", ForkedDbw) as page:
        page.until(lambda: page.shown.get("why") == ONLY_THE_BUTTON, SHOWN_S_MAX)
        page.say("button")
        page.until(lambda: page.shown["mode"] == "READY", SHOWN_S_MAX)
        page.say("engage")
        page.until(lambda: page.shown["mode"] == "AUTOMATIC", SHOWN_S_MAX)
        wish = {"speed_mps": 3.0}
        page.until(lambda: (page.shown["speed_mps"] or 0.0) > MOVING_MPS, STOP_S_MAX, wish)
        # Nothing is repeated now, as by a browser that froze: the car stops by itself.
        page.until(lambda: any("let go" in text for text in page.log), SHOWN_S_MAX)
        page.until(lambda: page.shown["speed_mps"] == 0.0, STOP_S_MAX)
        assert page.shown["mode"] == "AUTOMATIC", (page.shown["codes"], page.log)
        page.say("disengage")
        page.until(lambda: page.shown["mode"] in ("READY", "MANUAL"), STOP_S_MAX)
        assert page.refused == ""
