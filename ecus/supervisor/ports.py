"""What is wired to the supervisor."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisorSensors:
    """The panel."""

    button_pressed: bool
    """Auto/Manual button (UAH Section 4.3)."""
    emergency_stop_pressed: bool
    """Emergency-stop line, closed by the mushroom button or outside circuits (UWA Section 7.2)."""
    automatic_relay_closed: bool | None
    """Auxiliary contact of the latching manual/automatic relay; None: not read yet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisorActuator:
    """Coil of the latching manual/automatic relay, the multiplexer of UAH Section 4.3."""

    automatic_relay_closed: bool | None
    """None leaves the relay as it is, so that a dead or restarting supervisor frees no brake."""
