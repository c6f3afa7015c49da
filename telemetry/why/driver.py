"""Why a drive ended by wish: a touch of the driver, the button, the planner."""

from __future__ import annotations

from typing import Final

from dbc.messages import Mode, Request
from telemetry.why.evidence import NS_PER_S, SOON_NS, Evidence
from telemetry.why.incident import Cause, CauseKind
from telemetry.why.window import Heard

CONTROLS: Final = {
    "STEER_DRIVER": ("steering_wheel", "the driver turned the steering wheel ({0:.1f} N.m)",
                     "torque_nm"),
    "THROTTLE_DRIVER": ("throttle_pedal", "the driver pressed the throttle pedal ({0:.0%})",
                        "pedal_ratio"),
    "BRAKE_DRIVER": ("brake_pedal", "the driver pressed the brake pedal ({0:.0%})", "pedal_ratio"),
}
"""By message: what the driver used, the words, and the signal that shows it."""


def wish_of(evidence: Evidence, mode_after: Mode | None) -> tuple[Cause, ...]:
    """The causes of a disengagement; never empty."""
    if mode_after is Mode.MANUAL:
        touches = tuple(_touches(evidence))
        return touches or (_unknown("the log does not show what the driver used"),)
    if mode_after is Mode.STOPPING:
        return (_asked(evidence) or _button(evidence),)
    return (_unknown("the log does not show what led from driving to here"),)


def _touches(evidence: Evidence) -> list[Cause]:
    """Every control that was in use, first what was touched first."""
    debounce_ns = round(evidence.vehicle.times.driver_debounce_s * NS_PER_S)
    found = []
    for name, (subject, text, signal) in CONTROLS.items():
        newest = evidence.window.newest(name, evidence.at_ns)
        if newest is None or not newest.content.driver_active:
            continue
        first = _began(evidence, name, newest)
        value = abs(getattr(newest.content, signal))
        found.append(
            Cause(
                kind=CauseKind.DRIVER, subject=subject, since_ns=first.time_ns - debounce_ns,
                trigger=first, text=text.format(value),
            )
        )
    return sorted(found, key=lambda cause: cause.since_ns or 0)


def _began(evidence: Evidence, name: str, newest: Heard) -> Heard:
    """The first frame of the touch that the newest one tells of."""
    first = newest
    for row in reversed(evidence.window.usable(name)):
        if row.time_ns < newest.time_ns:
            if not row.content.driver_active:
                break
            first = row
    return first


def _asked(evidence: Evidence) -> Cause | None:
    for row in evidence.window.after("MODE_REQUEST", evidence.at_ns - SOON_NS):
        if row.time_ns <= evidence.at_ns and row.content.request is Request.DISENGAGE:
            return Cause(
                kind=CauseKind.PLANNER_REQUEST, subject="", since_ns=row.time_ns, trigger=row,
                text="the planner asked to disengage",
            )
    return None


def _button(evidence: Evidence) -> Cause:
    return Cause(
        kind=CauseKind.BUTTON, subject="button", since_ns=None, trigger=None,
        text="the Auto/Manual button was pressed (it is wired to the supervisor and not on the "
        "bus; nothing else on the bus asked for it)",
    )


def _unknown(text: str) -> Cause:
    return Cause(kind=CauseKind.UNKNOWN, subject="", since_ns=None, trigger=None, text=text)
