"""What is wired to the throttle ECU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

DAC_CODE_MAX: Final = 4095
"""12-bit DAC (UAH Section 4.2: MCP4725)."""
DAC_REFERENCE_V: Final = 5.0
DAC_IDLE_V: Final = 0.5
DAC_FULL_V: Final = 4.5


def dac_code(fraction: float) -> int:
    """DAC code for a torque demand of 0 to 1: 0.5 V to 4.5 V; outside it saturates."""
    volts = DAC_IDLE_V + min(max(fraction, 0.0), 1.0) * (DAC_FULL_V - DAC_IDLE_V)
    return round(volts / DAC_REFERENCE_V * DAC_CODE_MAX)


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class ThrottleSensors:
    """One reading of traction motor and throttle pedal."""

    encoder_count: Final[int]
    """Signed count of the motor encoder's rising edges since power-on."""
    encoder_edge_age_s: Final[float]
    """How long before this reading the latest edge came (1 us timer), at most 1.0."""
    pedal_ratio: Final[float]
    """Throttle pedal, 0 released to 1; NaN: broken."""

    def __init__(
        self,
        *,
        encoder_count: int,
        encoder_edge_age_s: float,
        pedal_ratio: float,
    ) -> None:
        self.encoder_count = encoder_count
        self.encoder_edge_age_s = encoder_edge_age_s
        self.pedal_ratio = pedal_ratio


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class ThrottleActuator:
    """The motor controller's two analogue inputs; unless refreshed, 0.5 V after 50 ms."""

    throttle_dac_code: Final[int]
    """0.5 V idle to 4.5 V full drive torque."""
    regen_dac_code: Final[int]
    """0.5 V none to 4.5 V full regenerative braking."""

    reverse_selected: Final[bool]
    """The controller's reverse contact: drive torque turns the wheels backwards. Without a refresh
    it opens: forwards. The controller obeys it at any speed: the ECU must not ask for that."""

    def __init__(
        self, *, throttle_dac_code: int, regen_dac_code: int, reverse_selected: bool = False
    ) -> None:
        self.throttle_dac_code = throttle_dac_code
        self.regen_dac_code = regen_dac_code
        self.reverse_selected = reverse_selected


IDLE: Final = ThrottleActuator(throttle_dac_code=dac_code(0.0), regen_dac_code=dac_code(0.0))
