"""What the traction motor does in each state: a total table.

Rules:
  FOLLOW the planner while ACTIVE in AUTOMATIC, STOP (regenerate to standstill) while STOPPING.
  In a safe state there is no drive torque: CUT. Where the brake servo is not seen to brake,
  REGENERATE with all there is.
  Everything else is IDLE: the multiplexer gives the throttle to the driver's pedal.
"""

from __future__ import annotations

from enum import Enum, IntEnum, auto
from typing import Final

from dbc.messages import NodeState


class ThrottleAction(Enum):
    """What the motor is for."""

    IDLE = auto()
    FOLLOW = auto()
    STOP = auto()
    CUT = auto()
    REGENERATE = auto()


class Situation(IntEnum):
    """What, besides the node's state, decides."""

    NORMAL = auto()
    STOPPING = auto()
    BRAKE_MISSING = auto()


_N, _A, _S = NodeState, ThrottleAction, Situation

ACTION: Final[dict[NodeState, dict[Situation, ThrottleAction]]] = {
    _N.STARTING: dict.fromkeys(_S, _A.IDLE),
    _N.RELEASED: dict.fromkeys(_S, _A.IDLE),
    _N.ACTIVE: {_S.NORMAL: _A.FOLLOW, _S.STOPPING: _A.STOP, _S.BRAKE_MISSING: _A.FOLLOW},
    _N.SAFE_ALONE: {_S.NORMAL: _A.CUT, _S.STOPPING: _A.CUT, _S.BRAKE_MISSING: _A.REGENERATE},
    _N.EMERGENCY: {_S.NORMAL: _A.CUT, _S.STOPPING: _A.CUT, _S.BRAKE_MISSING: _A.REGENERATE},
}
assert set(ACTION) == set(NodeState)
