"""Two SJA1000 controllers on one wire: can0 and can1, 500 kbit/s, the kernel's own driver.

The emulated wire carries frames at once and makes no errors of its own: bit timing, arbitration
and bus-off on a wire are the simulation's subject, and a real bus's.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from dbc.messages import Mode
from tests.vcan.shell import run
from tests.vcan.stack import PLANNER, Stack, pause

ACROSS = ("supervisor", "safety_monitor", PLANNER)
"""These are on can1, the actuators on can0: every drive crosses the wire."""


@pytest.fixture(scope="module")
def module_stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    folder = tmp_path_factory.mktemp("controllers")
    with Stack(folder, channel="can0", channels=dict.fromkeys(ACROSS, "can1")) as stack:
        yield stack


def link(name: str) -> dict[str, Any]:
    """What `ip` says of a network."""
    text = run(f"ip -json -details -statistics link show {name}")
    answer: list[dict[str, Any]] = json.loads(text)
    return answer[0]


def test_the_car_drives_and_stops_over_two_controllers(parked: Stack) -> None:
    before = {name: link(name) for name in ("can0", "can1")}
    parked.drive()
    pause(0.5)
    assert parked.mode is Mode.AUTOMATIC
    assert parked.planner.attempt("disengage") is None
    assert abs(parked.truth().speed_mps) < 0.05
    for name in ("can0", "can1"):
        now = link(name)
        details = now["linkinfo"]["info_data"]
        assert details["state"] == "ERROR-ACTIVE"
        assert details["bittiming"]["bitrate"] == 500_000
        for way in ("rx", "tx"):
            assert now["stats64"][way]["packets"] > before[name]["stats64"][way]["packets"] + 100
            assert now["stats64"][way]["errors"] == before[name]["stats64"][way]["errors"]
            assert now["stats64"][way]["dropped"] == before[name]["stats64"][way]["dropped"]


def test_a_controller_switched_off_stops_the_car_on_both_sides(driving: Stack) -> None:
    run("ip link set can1 down")
    try:
        driving.brakes()
    finally:
        run("ip link set can1 up")
    pause(0.3)
    driving.recover()
    driving.drive()
    assert driving.mode is Mode.AUTOMATIC
