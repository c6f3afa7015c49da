"""Throttle voltage through a filtered PWM (UWA 5 and 8), and through this stack's DAC.

The Uno has no DAC: a PWM of 8 bits goes through a low-pass filter and an isolating amplifier of
unity gain. UWA raised the PWM's frequency so that the filter may be fast. The paper does not print
the filter; here it is a resistor and a capacitor.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np

from ecus.throttle.ports import DAC_CODE_MAX, DAC_FULL_V, DAC_IDLE_V, DAC_REFERENCE_V, dac_code
from experiments.drawing import BASELINE, OURS, PAPER, picture
from experiments.response import FloatArray
from experiments.result import NAN, Goal, Outcome, Row, Setting, baseline_within, ours_at_most_share
from experiments.uwa.paper_board import BYTE_MAX, PWM_STEPS, SUPPLY_V

CLOCK_HZ: Final = 16e6
"""Arduino Uno; its timers count PWM_STEPS + 1 of a divided clock, or up and down."""
PWM_HZ: Final = CLOCK_HZ / 8 / (PWM_STEPS + 1)
"""Fast PWM with a divider of 8, the setting of the ATmega328P that comes next to 7.8 kHz."""
DEFAULT_HZ: Final = CLOCK_HZ / 64 / (2 * PWM_STEPS)
"""Phase-correct PWM with a divider of 64: the Uno's default."""

RESISTOR_OHM: Final = 1000.0
CAPACITOR_F: Final = 10e-6
"""Assumption: the ripple stays below an increment, and the pin gives 5 mA of its 40 mA at most."""
FILTER_S: Final = RESISTOR_OHM * CAPACITOR_F

HALL_LOW_V, HALL_HIGH_V = 1.0, 4.0
"""Assumption: of the pedal's sensor; UWA 5 wants 4 V of the output."""

PAPER_STEP_V: Final = 0.02
PAPER_PWM_KHZ: Final = 7.8
PAPER_DEFAULT_HZ: Final = 490.0


def filtered_v(duty: float, pwm_hz: float, filter_s: float, at: FloatArray) -> FloatArray:
    """The filter's output in its steady state over one period of the PWM.

    Args:
        duty: 0 to 1.
        pwm_hz: Of the PWM.
        filter_s: The filter's time constant.
        at: Where in the period, 0 to 1, from the rising edge on.
    """
    period = 1.0 / (pwm_hz * filter_s)
    low_v, high_v = _ends(duty, period)
    rising = SUPPLY_V - (SUPPLY_V - low_v) * np.exp(-at * period)
    falling = high_v * np.exp(-(at - duty) * period)
    return np.where(at < duty, rising, falling)


def _ends(duty: float, period: float) -> tuple[float, float]:
    """Lowest and highest output; the period in time constants."""
    high_v = SUPPLY_V * math.expm1(-duty * period) / math.expm1(-period)
    return high_v * math.exp(-(1.0 - duty) * period), high_v


def ripple_v(duty: float, pwm_hz: float, filter_s: float) -> float:
    """From the lowest to the highest output."""
    low_v, high_v = _ends(duty, 1.0 / (pwm_hz * filter_s))
    return high_v - low_v


def multimeter_v(command: int) -> float:
    """The mean that a multimeter shows for an increment count."""
    at = (np.arange(4096) + 0.5) / 4096
    return float(filtered_v(command / PWM_STEPS, PWM_HZ, FILTER_S, at).mean())


def slope_v(commands: FloatArray, volts: FloatArray) -> float:
    """Volts per increment within the pedal sensor's range."""
    inside = (volts >= HALL_LOW_V) & (volts <= HALL_HIGH_V)
    return float(np.polyfit(commands[inside], volts[inside], 1)[0])


def run(setting: Setting, file: Path) -> Outcome:
    """The voltage over the command, the ripple, and what the frequency is for."""
    commands = np.arange(BYTE_MAX + 1, dtype=float)
    volts = np.array([multimeter_v(int(command)) for command in commands])
    codes = np.arange(dac_code(0.0), dac_code(1.0) + 1, dtype=float)
    dac_v = codes / DAC_CODE_MAX * DAC_REFERENCE_V
    ripple = max(ripple_v(command / PWM_STEPS, PWM_HZ, FILTER_S) for command in commands)
    slow_s = FILTER_S * PWM_HZ / DEFAULT_HZ
    _draw(file, commands, volts, dac_v, slow_s)
    near = baseline_within(0.10)
    below = Goal("baseline below an increment", lambda row: row.baseline_value <= PAPER_STEP_V)
    rows = (
        _row("step_v", "throttle voltage per increment", "V", PAPER_STEP_V,
             slope_v(commands, volts), slope_v(codes, dac_v), near,
             ours_at_most_share(0.1, "baseline")),
        _row("pwm_khz", "frequency of the PWM", "kHz", PAPER_PWM_KHZ, PWM_HZ / 1e3, NAN, near),
        _row("default_hz", "frequency of the Uno's default PWM", "Hz", PAPER_DEFAULT_HZ,
             DEFAULT_HZ, NAN, near),
        _row("ripple_v", "ripple behind the filter", "V", NAN, ripple, NAN, below),
    )  # fmt: skip
    return Outcome(rows=rows, notes=(
        f"The paper does not print the filter: {RESISTOR_OHM:g} ohm and {CAPACITOR_F * 1e6:g} uF "
        f"are assumed, so that the ripple stays below an increment. At the Uno's default of "
        f"{DEFAULT_HZ:.0f} Hz a filter with the same ripple would need {1e3 * slow_s:.0f} ms in "
        f"place of {1e3 * FILTER_S:.0f} ms (right picture): that is what the frequency was raised "
        "for.",
        f"5 V over {PWM_STEPS} increments are 0.0196 V, which the paper prints as 0.02 V. Ours is "
        f"the 12-bit DAC between {DAC_IDLE_V:g} V and {DAC_FULL_V:g} V; it has neither ripple nor "
        "filter.",
        "The 7.7 V of Eq. 1 follow from two data sheets (MAX680, ISO124) whose currents and "
        "resistance the paper does not print: not repeated here.",
    ))  # fmt: skip


def _row(
    name: str, quantity: str, unit: str, paper: float, baseline: float, ours: float, *goals: Goal
) -> Row:
    return Row(id=f"uwa.throttle.{name}", paper="uwa", quantity=quantity, unit=unit,
               paper_value=paper, baseline_value=baseline, ours_value=ours,
               goals=goals)  # fmt: skip


def _draw(
    file: Path, commands: FloatArray, volts: FloatArray, dac_v: FloatArray, slow_s: float
) -> None:
    with picture(file, 3.8, columns=2) as (line, step):
        line.plot(commands, volts, color=BASELINE, label="UWA's filtered PWM")
        share = np.linspace(0.0, 1.0, dac_v.size)
        line.plot(share * BYTE_MAX, dac_v, color=OURS, label="ours: DAC, idle to full")
        line.axhspan(HALL_LOW_V, HALL_HIGH_V, color=PAPER, alpha=0.15)
        line.set_xlabel("throttle command, of 255")
        line.set_ylabel("throttle voltage, V")
        line.legend(loc="upper left")
        time_s = np.linspace(0.0, 0.4, 400)
        for filter_s, colour, hz in ((FILTER_S, BASELINE, PWM_HZ), (slow_s, PAPER, DEFAULT_HZ)):
            step.plot(1e3 * time_s, SUPPLY_V * -np.expm1(-time_s / filter_s), color=colour,
                      label=f"filter for {hz / 1e3:.2g} kHz")  # fmt: skip
        step.set_xlabel("time since a step to full, ms")
        step.set_ylabel("throttle voltage, V")
        step.legend(loc="lower right")
