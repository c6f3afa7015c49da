"""A planner in a process of its own, told over a pipe what to ask of the car."""

from __future__ import annotations

from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from dbc.messages import ErrorCode, Mode
from gateway.api import Car
from gateway.connect import connect
from gateway.errors import DisengageFailed, EngageRefused, ResetRefused
from gateway.state import CarState
from runtime.realtime import keep_collections_short

PERIOD_S = 0.02
ANSWER_S_MAX = 40.0
"""The longest call is `disengage`, which waits for standstill."""


class View(NamedTuple):
    """What a test wants to know of the car's state."""

    mode: Mode | None
    why_not_engaged: str
    speed_mps: float
    codes: tuple[ErrorCode, ...]


def planner_main(channel: str, vehicle: str, control: Connection) -> None:
    """Decides at 50 Hz while it is told to."""
    target: tuple[float, float] | None = None
    keep_collections_short()
    with connect("socketcan", channel, vehicle=vehicle, planner_period_s=PERIOD_S) as car:
        for state in car.ticks(PERIOD_S):
            while control.poll():
                name, arguments = control.recv()
                if name == "go":
                    target = arguments
                elif name == "state":
                    control.send(_view(state))
                else:
                    control.send(_try(car, name, arguments))
            if target is not None:
                car.command(speed_mps=target[0], curvature_per_m=target[1])


def _view(state: CarState) -> View:
    return View(state.mode, state.why_not_engaged, state.speed_mps, state.codes or ())


def _try(car: Car, name: str, arguments: dict[str, Any]) -> str | None:
    try:
        getattr(car, name)(**arguments)
    except (EngageRefused, DisengageFailed, ResetRefused) as error:
        return str(error)
    return None


def answer(control: Connection) -> Any:
    """What a process answers; one that does not fails the test, and never hangs it."""
    assert control.poll(ANSWER_S_MAX), "the process does not answer"
    return control.recv()


class Planner:
    """The test's end of the pipe."""

    def __init__(self, control: Connection) -> None:
        self._control = control

    def go(self, speed_mps: float, curvature_per_m: float = 0.0) -> None:
        """Decides so from now on."""
        self._control.send(("go", (speed_mps, curvature_per_m)))

    def stop(self) -> None:
        """Decides nothing any more."""
        self._control.send(("go", None))

    def state(self) -> View:
        """What the public API says of the car."""
        self._control.send(("state", None))
        view: View = answer(self._control)
        return view

    def attempt(self, name: str, **arguments: Any) -> str | None:
        """Calls a method of the API; answers why it was refused, or None."""
        self._control.send((name, arguments))
        refusal: str | None = answer(self._control)
        return refusal
