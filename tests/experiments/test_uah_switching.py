"""What the switching run hears on the wire."""

from __future__ import annotations

import math

import pytest

from dbc.endpoint import Endpoint
from dbc.messages import Inhibit, Mode, SteerStatus, SupervisorState
from experiments.uah.switching import ECU_HEARS_NS, Wire


def state(mode: Mode) -> SupervisorState:
    return SupervisorState(
        mode=mode, steering_authorised=False, throttle_authorised=False, brake_authorised=False,
        er0=False, er1=False, er2=False, er3=False, er4=False, er5=False, er6=False,
        reset_epoch=0, decision_age_ms_max=85, inhibit=Inhibit.NONE,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("mode", "setpoint_rad", "after_ns", "stray"),
    [
        (Mode.MANUAL, 0.5, ECU_HEARS_NS + 1, 1),
        (Mode.READY, 0.5, ECU_HEARS_NS + 1, 1),
        (Mode.MANUAL, 0.5, ECU_HEARS_NS, 0),  # the ECU cannot know yet
        (Mode.MANUAL, math.nan, ECU_HEARS_NS + 1, 0),
        (Mode.AUTOMATIC, 0.5, ECU_HEARS_NS + 1, 0),
    ],
)
def test_a_setpoint_in_force_while_a_human_drives_is_counted(
    mode: Mode, setpoint_rad: float, after_ns: int, stray: int
) -> None:
    wire, supervisor, steering = Wire(), Endpoint("Supervisor", ()), Endpoint("Steering", ())
    wire.hear(1000, "Supervisor", supervisor.frame("SUPERVISOR_STATE", state(mode)))
    told = SteerStatus(steering_wheel_angle_rad=0.5, applied_steering_wheel_angle_rad=setpoint_rad)
    wire.hear(1000 + after_ns, "Steering", steering.frame("STEER_STATUS", told))
    assert wire.stray == stray
    assert wire.switched == [(1000, mode)]
