"""What is wired to the throttle ECU."""

from __future__ import annotations

from dataclasses import dataclass

DAC_CODE_MAX = 4095
"""12-bit DAC (UAH Section 4.2: MCP4725)."""
DAC_REFERENCE_V = 5.0
DAC_IDLE_V = 0.5
DAC_FULL_V = 4.5


def dac_code(fraction: float) -> int:
    """DAC code for a torque demand of 0 to 1: 0.5 V to 4.5 V; outside it saturates."""
    volts = DAC_IDLE_V + min(max(fraction, 0.0), 1.0) * (DAC_FULL_V - DAC_IDLE_V)
    return round(volts / DAC_REFERENCE_V * DAC_CODE_MAX)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThrottleSensors:
    """One reading of traction motor and throttle pedal."""

    encoder_count: int
    """Signed count of the motor encoder's rising edges since power-on."""
    encoder_edge_age_s: float
    """How long before this reading the latest edge came (1 us timer), at most 1.0."""
    pedal_ratio: float
    """Throttle pedal, 0 released to 1; NaN: broken."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThrottleActuator:
    """The motor controller's two analogue inputs; unless refreshed, 0.5 V after 50 ms."""

    throttle_dac_code: int
    """0.5 V idle to 4.5 V full drive torque."""
    regen_dac_code: int
    """0.5 V none to 4.5 V full regenerative braking."""


IDLE = ThrottleActuator(throttle_dac_code=dac_code(0.0), regen_dac_code=dac_code(0.0))
