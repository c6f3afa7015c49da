"""What the steering motor does in each state: a total table.

Rules:
  FOLLOW the planner only while ACTIVE.
  In a safe state HOLD the angle while the car brakes, so that it does not swerve, until it is
  nearly standing; a driver's hand, a motor fault (ER4) or a broken sensor (ER6) end that for good.
  Everything else is COAST: the motor is open, the wheel is the driver's.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final

from dbc.messages import NodeState


class SteerAction(Enum):
    """What the motor is for."""

    COAST = auto()
    FOLLOW = auto()
    HOLD = auto()


_N, _A = NodeState, SteerAction

ACTION: Final[dict[NodeState, dict[bool, SteerAction]]] = {
    # state: {may hold: action}
    _N.STARTING: {False: _A.COAST, True: _A.COAST},
    _N.RELEASED: {False: _A.COAST, True: _A.COAST},
    _N.ACTIVE: {False: _A.FOLLOW, True: _A.FOLLOW},
    _N.SAFE_ALONE: {False: _A.COAST, True: _A.HOLD},
    _N.EMERGENCY: {False: _A.COAST, True: _A.HOLD},
}
assert set(ACTION) == set(NodeState)
