"""What is wired to the supervisor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class SupervisorSensors:
    """The panel."""

    button_pressed: Final[bool]
    """Auto/Manual button (UAH Section 4.3)."""
    emergency_stop_pressed: Final[bool]
    """Emergency-stop line, closed by the mushroom button or outside circuits (UWA Section 7.2)."""
    automatic_relay_closed: Final[bool | None]
    """Auxiliary contact of the latching manual/automatic relay; None: not read yet."""

    def __init__(
        self,
        *,
        button_pressed: bool,
        emergency_stop_pressed: bool,
        automatic_relay_closed: bool | None,
    ) -> None:
        self.button_pressed = button_pressed
        self.emergency_stop_pressed = emergency_stop_pressed
        self.automatic_relay_closed = automatic_relay_closed


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class SupervisorActuator:
    """Coil of the latching manual/automatic relay, the multiplexer of UAH Section 4.3."""

    automatic_relay_closed: Final[bool | None]
    """None leaves the relay as it is, so that a dead or restarting supervisor frees no brake."""

    def __init__(self, *, automatic_relay_closed: bool | None) -> None:
        self.automatic_relay_closed = automatic_relay_closed
