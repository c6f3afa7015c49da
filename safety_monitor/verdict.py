"""The verdict: a total table.

Rules:
  DENY by default, and until everything has been healthy for half a second without a gap.
  While the car drives itself a hazard means BRAKE, and stays BRAKE until the drive has ended.
  While it does not, the same hazard only denies: nothing brakes under a human driver.
  A doubt (a stranger's frame, a frame ignored) denies the next drive and does not end this one.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from dbc.messages import Verdict


class Severity(IntEnum):
    """How grave the worst finding of a step is."""

    NONE = 0
    DOUBT = 1
    HAZARD = 2


class Phase(IntEnum):
    """What the monitor has seen of the drive."""

    UNPROVEN = 0
    """Not everything has been healthy for long enough."""
    PROVEN = 1
    """Healthy; the car may begin to drive."""
    DRIVING = 2
    """AUTOMATIC or STOPPING."""
    VETOED = 3
    """A hazard was seen in this drive."""


_S, _P, _V = Severity, Phase, Verdict

VERDICT_OF: Final[dict[Phase, dict[Severity, Verdict]]] = {
    _P.UNPROVEN: {_S.NONE: _V.DENY, _S.DOUBT: _V.DENY, _S.HAZARD: _V.DENY},
    _P.PROVEN: {_S.NONE: _V.PERMIT, _S.DOUBT: _V.DENY, _S.HAZARD: _V.DENY},
    _P.DRIVING: {_S.NONE: _V.PERMIT, _S.DOUBT: _V.PERMIT, _S.HAZARD: _V.BRAKE},
    _P.VETOED: {_S.NONE: _V.BRAKE, _S.DOUBT: _V.BRAKE, _S.HAZARD: _V.BRAKE},
}
assert set(VERDICT_OF) == set(Phase)
assert all(set(row) == set(Severity) for row in VERDICT_OF.values())
