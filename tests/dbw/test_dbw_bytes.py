"""`dbw bytes`: its echo on a bus of this process, and mistakes in one line."""

from __future__ import annotations

import time

import pytest

from canbus.bus import BusError
from canbus.frame import Frame
from canbus.python_can_bus import PythonCanBus
from dbw.byte_planner import serve_bus
from dbw.failures import UserMistake
from dbw.main import main
from gateway.connect import connect
from vehicles import load_vehicle

Capture = pytest.CaptureFixture[str]


def test_a_planner_on_the_bus_gets_its_bytes_back_and_hears_of_a_missing_supervisor(
    capsys: Capture,
) -> None:
    with PythonCanBus("virtual", "byte_test", clock=time.monotonic_ns) as planner:
        heard: list[Frame] = []

        def is_stopped() -> bool:
            planner.send(Frame(0x412, b"\xf6"))
            heard.extend(item.frame for item in planner.receive(0))
            return any(frame.can_id == 0x422 for frame in heard)

        serve_bus("virtual", "byte_test", load_vehicle("fsae_electric"), 0.05, is_stopped)
    assert Frame(0x422, b"\xf6") in heard
    assert Frame(0x423, b"\x04") in heard, "ER2: no supervisor is heard"
    assert "0x410 BYTE_BRAKE, 0x411 BYTE_ACCELERATE, 0x412 BYTE_STEER" in capsys.readouterr().out


def test_garbage_is_collected_before_the_gateway_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    def opened(*_: object, **__: object) -> None:
        done.append("opened")
        raise BusError("far enough")

    monkeypatch.setattr("runtime.realtime.keep_collections_short", lambda: done.append("collected"))
    monkeypatch.setattr("gateway.connect.connect", opened)
    with pytest.raises(BusError, match="far enough"):
        serve_bus("virtual", "collects", load_vehicle("tabby_evo"), 0.1, lambda: True)
    assert done == ["collected", "opened"]


def test_a_bus_that_has_a_gateway_gets_no_second_one() -> None:
    with (
        connect("virtual", "byte_two", vehicle="fsae_electric"),
        pytest.raises(UserMistake, match="another gateway is on byte_two"),
    ):
        serve_bus("virtual", "byte_two", load_vehicle("fsae_electric"), 0.05, lambda: True)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--vehicle", "fsea"], "allowed baja_5b, fsae_electric, tabby_evo"),
        (["--period", "0.5", "--vehicle", "fsae_electric"], "planner_period_s = 0.5: allowed 0.01"),
        (["--period", "nan"], "planner_period_s = nan: allowed 0.01"),
        (["--channel", "no such"], "a name without blanks is wanted"),
        (["--interface", "socketcam"], "socketcam"),
        (["--interface", "virtual"], "a virtual bus lives inside one process"),
    ],
)
def test_a_mistake_is_one_line(arguments: list[str], expected: str, capsys: Capture) -> None:
    assert main(["bytes", *arguments]) == 2
    error = capsys.readouterr().err
    assert expected in error and error.startswith("dbw: error: ") and error.count("\n") == 1
