"""Frames for the monitor's tests, heard on can0 unless said otherwise."""

from __future__ import annotations

from typing import Any

from canbus.candump import parse_log_line
from canbus.heard import CLASSICAL, Heard
from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import SPECS, Heartbeat, HeartbeatState, SteerStatus
from telemetry.monitor.known import Catalogue
from telemetry.monitor.meaning import Interpreter

MS = 1_000_000
S = 1_000_000_000

FOREIGN_DBC = """VERSION ""
BU_: Motor Panel
BO_ 256 ENGINE: 8 Motor
 SG_ speed : 0|16@1+ (0.25,0) [0|16000] "rpm" Panel
 SG_ gear : 16|4@1+ (1,0) [0|15] "" Panel
 SG_ temperature : 24|8@1+ (1,-40) [-40|215] "degC" Panel
BO_ 2566844926 TRUCK: 4 Motor
 SG_ load : 0|8@1+ (1,0) [0|100] "%" Panel
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 100;
VAL_ 256 gear 0 "neutral" 1 "first" ;
"""


def heard(text: str, time_ns: int = 0, channel: str = "can0") -> Heard:
    """A frame as candump -L writes it: `123#1122`."""
    item = parse_log_line(f"(0.0) {channel} {text}")
    assert item is not None, text
    return item._replace(time_ns=time_ns)


def own(name: str, message: Any, counter: int = 0, time_ns: int = 0) -> Heard:
    """A message of the vehicle bus."""
    frame = encode(SPEC_OF_NAME[name], message, counter)
    return Heard(time_ns, "can0", frame.can_id, frame.data, len(frame.data), CLASSICAL)


def steering(angle_rad: float = 0.5, counter: int = 0, time_ns: int = 0) -> Heard:
    """STEER_STATUS."""
    message = SteerStatus(
        steering_wheel_angle_rad=angle_rad, applied_steering_wheel_angle_rad=float("nan")
    )
    return own("STEER_STATUS", message, counter, time_ns)


def heartbeat(name: str = "STEER_HEARTBEAT", time_ns: int = 0) -> Heard:
    """A heartbeat of an operational node."""
    return own(name, Heartbeat(state=HeartbeatState.OPERATIONAL), time_ns=time_ns)


def interpreter() -> Interpreter:
    """Of the project's own bus."""
    return Interpreter(Catalogue())


assert 0x182 in SPECS
