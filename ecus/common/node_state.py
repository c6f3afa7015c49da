"""The state machine that steer, throttle and brake ECU share.

Rules:
  An actuator moves only in ACTIVE, or by its own safe state in SAFE_ALONE and EMERGENCY.
  ACTIVE is entered only from RELEASED, by the supervisor's word and the node's own checks.
  SAFE_ALONE: the node's own checks failed while it drove; it acts without waiting for anybody.
  Both safe states end by a supervisor in MANUAL alone: there a human drives, or a reset was given;
  READY with another reset epoch tells of a MANUAL that was not heard.
"""

from __future__ import annotations

from enum import IntEnum, auto
from typing import Final

from dbc.messages import NodeState


class NodeEvent(IntEnum):
    """One event a step, highest priority first."""

    MANUAL = auto()
    """A fresh SUPERVISOR_STATE says that a human drives: nothing brakes under him."""
    EMERGENCY = auto()
    """The supervisor is in EMERGENCY; while driving also any EMERGENCY_BRAKE or FAILSAFE frame."""
    OWN_CAUSE = auto()
    """A check of the node itself failed."""
    UNAUTHORISED = auto()
    """The supervisor does not authorise this axis."""
    AUTHORISED = auto()
    """AUTOMATIC or STOPPING, this axis authorised, and the node was armed before."""
    NOTHING = auto()


_N, _E = NodeState, NodeEvent

NODE_STATE_AFTER: Final[dict[NodeState, dict[NodeEvent, NodeState]]] = {
    _N.STARTING: {
        _E.MANUAL: _N.RELEASED,
        _E.EMERGENCY: _N.EMERGENCY,
        _E.OWN_CAUSE: _N.STARTING,
        _E.UNAUTHORISED: _N.RELEASED,
        _E.AUTHORISED: _N.RELEASED,
        _E.NOTHING: _N.STARTING,
    },
    _N.RELEASED: {
        _E.MANUAL: _N.RELEASED,
        _E.EMERGENCY: _N.EMERGENCY,
        _E.OWN_CAUSE: _N.RELEASED,
        _E.UNAUTHORISED: _N.RELEASED,
        _E.AUTHORISED: _N.ACTIVE,
        _E.NOTHING: _N.RELEASED,
    },
    _N.ACTIVE: {
        _E.MANUAL: _N.RELEASED,
        _E.EMERGENCY: _N.EMERGENCY,
        _E.OWN_CAUSE: _N.SAFE_ALONE,
        _E.UNAUTHORISED: _N.RELEASED,
        _E.AUTHORISED: _N.ACTIVE,
        _E.NOTHING: _N.ACTIVE,
    },
    _N.SAFE_ALONE: {
        _E.MANUAL: _N.RELEASED,
        _E.EMERGENCY: _N.EMERGENCY,
        _E.OWN_CAUSE: _N.SAFE_ALONE,
        _E.UNAUTHORISED: _N.SAFE_ALONE,
        _E.AUTHORISED: _N.SAFE_ALONE,
        _E.NOTHING: _N.SAFE_ALONE,
    },
    _N.EMERGENCY: {
        _E.MANUAL: _N.RELEASED,
        _E.EMERGENCY: _N.EMERGENCY,
        _E.OWN_CAUSE: _N.EMERGENCY,
        _E.UNAUTHORISED: _N.EMERGENCY,
        _E.AUTHORISED: _N.EMERGENCY,
        _E.NOTHING: _N.EMERGENCY,
    },
}

SAFE_STATES: Final = frozenset({_N.SAFE_ALONE, _N.EMERGENCY})
"""States in which the node does what is safe rather than what it is told."""

assert all(set(row) == set(NodeEvent) for row in NODE_STATE_AFTER.values())
assert set(NODE_STATE_AFTER) == set(NodeState)
