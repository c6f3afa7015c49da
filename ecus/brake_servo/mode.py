"""What the brake servo does in each state: a total table.

Rules:
  FOLLOW the command while ACTIVE in AUTOMATIC; STOP with a comfortable force in STOPPING.
  A safe state means FULL, however long it takes, while the car moves.
  Too long on (ER3) at standstill means REST: released to save the servo, applied again when the
  car rolls. While moving, ER3 is reported and braking goes on.
  Everything else is RELEASE: nothing brakes under a human driver.
"""

from __future__ import annotations

from enum import Enum, IntEnum, auto
from typing import Final

from dbc.messages import NodeState


class BrakeAction(Enum):
    """What the servo is for."""

    RELEASE = auto()
    FOLLOW = auto()
    STOP = auto()
    FULL = auto()
    REST = auto()


class Situation(IntEnum):
    """What, besides the node's state, decides."""

    NORMAL = auto()
    STOPPING = auto()
    RESTING = auto()


_N, _A, _S = NodeState, BrakeAction, Situation

ACTION: Final[dict[NodeState, dict[Situation, BrakeAction]]] = {
    _N.STARTING: dict.fromkeys(_S, _A.RELEASE),
    _N.RELEASED: dict.fromkeys(_S, _A.RELEASE),
    _N.ACTIVE: {_S.NORMAL: _A.FOLLOW, _S.STOPPING: _A.STOP, _S.RESTING: _A.REST},
    _N.SAFE_ALONE: {_S.NORMAL: _A.FULL, _S.STOPPING: _A.FULL, _S.RESTING: _A.REST},
    _N.EMERGENCY: {_S.NORMAL: _A.FULL, _S.STOPPING: _A.FULL, _S.RESTING: _A.REST},
}
assert set(ACTION) == set(NodeState)
