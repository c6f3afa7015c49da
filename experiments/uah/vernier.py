"""The angle sensor of two small gears on a big one (UAH 4.1, Eq. 1-3), encoder and DAC.

Each small gear turns a magnet over a sensor that gives sine and cosine with a period of 180 deg; an
ADC of 16 bits reads them. The two small angles drift apart as the big gear turns: their difference
tells where it is (Eq. 1 and 2) as long as it has not come round (Eq. 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.random import Generator

from ecus.common.encoder import EncoderSpeed
from ecus.throttle.ports import DAC_CODE_MAX, DAC_FULL_V, DAC_IDLE_V, DAC_REFERENCE_V
from experiments.drawing import BASELINE, OURS, picture
from experiments.response import FloatArray
from experiments.result import (
    NAN,
    Goal,
    Outcome,
    Row,
    Setting,
    TableOfWords,
    baseline_within,
    ours_at_most_share,
)
from simulation.plant.params import TABBY_EVO
from simulation.plant.sensors import Encoder

ADC_RANGE_V: Final = 0.256
"""ADS1115 at its highest gain: plus and minus so much over 16 bits."""
ADC_STEP_V: Final = 2.0 * ADC_RANGE_V / 2**16
SENSOR_V: Final = 0.080
"""UAH 4.1: the KMZ41 gives plus and minus 80 mV."""
NOISE_V: Final = ADC_STEP_V
"""Assumption: one step of noise, as the ADS1115's data sheet has it at this gain."""
WORKING_RANGE_DEG: Final = 2.0 * math.degrees(9.25)


@dataclass(frozen=True, slots=True, kw_only=True)
class Vernier:
    """The gears and the magnets' period."""

    main_teeth: int
    first_teeth: int
    second_teeth: int
    period_deg: float = 180.0

    @property
    def range_deg(self) -> float:
        """Eq. 3."""
        multiple = math.lcm(self.first_teeth, self.second_teeth)
        return multiple * self.period_deg / self.main_teeth

    @property
    def unambiguous_deg(self) -> float:
        """After how much the difference that Eq. 1 uses has come round.

        Equal to Eq. 3 only if the small gears differ by their greatest common divisor.
        """
        teeth = self.first_teeth * self.second_teeth
        apart = abs(self.second_teeth - self.first_teeth)
        return teeth * self.period_deg / (self.main_teeth * apart)

    def small_angles_deg(self, angle_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of both small gears within the magnets' period, without any error."""
        first = angle_deg * self.main_teeth / self.first_teeth
        second = angle_deg * self.main_teeth / self.second_teeth
        return np.mod(first, self.period_deg), np.mod(second, self.period_deg)

    def coarse_deg(self, first_deg: FloatArray, second_deg: FloatArray) -> FloatArray:
        """The paper's angle: Eq. 1 and 2."""
        apart = first_deg - second_deg
        apart = np.where(apart < 0.0, apart + self.period_deg, apart)
        return apart * self.range_deg / self.period_deg

    def fine_deg(self, first_deg: FloatArray, second_deg: FloatArray) -> FloatArray:
        """Ours: Eq. 1 only counts the first gear's periods, its own angle gives the rest."""
        step_deg = self.period_deg * self.first_teeth / self.main_teeth
        within = first_deg * self.first_teeth / self.main_teeth
        return within + np.round((self.coarse_deg(first_deg, second_deg) - within) / step_deg) * (
            step_deg
        )


GEARS: Final = Vernier(main_teeth=100, first_teeth=24, second_teeth=25)
"""Assumption: the paper prints no teeth; these are the next range above the wheel's 1060 deg."""


def measured_deg(small_deg: FloatArray, noise_v: float, rng: Generator) -> FloatArray:
    """A small gear's angle as sine and cosine, noise and ADC leave it."""
    electrical = np.radians(2.0 * small_deg)
    sine, cosine = (
        np.round((SENSOR_V * wave + noise_v * rng.standard_normal(small_deg.shape)) / ADC_STEP_V)
        for wave in (np.sin(electrical), np.cos(electrical))
    )
    return np.mod(np.degrees(np.arctan2(sine, cosine)) / 2.0, 180.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Over the working range in the middle of the sensor's."""

    coarse_deg_max: float
    fine_deg_max: float
    wrong_share: float
    """Of the readings of Eq. 1 that are off by more than half of a first gear's period."""


def errors(gears: Vernier, noise_v: float, rng: Generator, count: int = 100_000) -> Errors:
    """Readings at so many places, evenly over the working range, against the truth."""
    middle = 0.5 * gears.range_deg
    half = 0.5 * WORKING_RANGE_DEG
    truth = np.linspace(middle - half, middle + half, count)
    first, second = (
        measured_deg(small, noise_v, rng) for small in gears.small_angles_deg(truth)
    )
    coarse = np.abs(gears.coarse_deg(first, second) - truth)
    limit_deg = 0.5 * gears.period_deg * gears.first_teeth / gears.main_teeth
    return Errors(
        coarse_deg_max=float(coarse.max()),
        fine_deg_max=float(np.abs(gears.fine_deg(first, second) - truth).max()),
        wrong_share=float((coarse > limit_deg).mean()),
    )


def speed_errors_degps(speed_degps: float) -> tuple[float, float]:
    """Largest error of a steady wheel speed: pulses per 100 ms, and our edge timing at 10 ms."""
    sensors, step_ns = TABBY_EVO.sensors, TABBY_EVO.step_ns
    pulses_per_deg = sensors.motor_pulses_per_rev * TABBY_EVO.traction.gear_ratio / 360.0
    encoder = Encoder(
        pulses_per_deg, step_ns, sensors.encoder_timer_ns, sensors.edge_age_ns_max, 0
    )
    timing = EncoderSpeed(360.0 * pulses_per_deg)
    counted, timed, count_before = [], [], 0
    for number in range(1, 1001):
        begin_ns = (number - 1) * 10_000_000
        for now_ns in range(begin_ns, begin_ns + 10_000_000, step_ns):
            encoder.step(now_ns, speed_degps)
        count, age_s = encoder.read(number * 10_000_000, False)
        timed.append(math.degrees(timing.update(number * 10_000_000, count, age_s)))
        if number % 10 == 0:
            counted.append((count - count_before) / pulses_per_deg / 0.1)
            count_before = count
    return (
        float(np.abs(np.array(counted[1:]) - speed_degps).max()),
        float(np.abs(np.array(timed[20:]) - speed_degps).max()),
    )


def run(setting: Setting, file: Path) -> Outcome:
    """Range, resolution and error of the angle sensor; steps of the encoder and of the DAC."""
    found = errors(GEARS, NOISE_V, setting.rng)
    noises_v = NOISE_V * np.array([0.0, 1.0, 4.0, 16.0, 64.0, 256.0, 512.0])
    by_noise = [errors(GEARS, float(noise_v), setting.rng, 20_000) for noise_v in noises_v]
    _draw(file, setting.rng)
    table = TableOfWords(
        title="Noise against ambiguity, over the steering wheel's +-9.25 rad",
        headers=("noise, ADC steps", "Eq. 1, largest error, deg", "refined, largest error, deg",
                 "Eq. 1 in the wrong period of the first gear, %"),
        rows=tuple(
            (f"{noise_v / ADC_STEP_V:g}", f"{one.coarse_deg_max:.3g}", f"{one.fine_deg_max:.3g}",
             f"{100.0 * one.wrong_share:.3g}")
            for noise_v, one in zip(noises_v, by_noise, strict=True)
        ),
    )  # fmt: skip
    return Outcome(rows=_rows(found), notes=_NOTES, tables=(table,))


_NOTES = (
    "The paper prints no numbers of teeth. 100, 24 and 25 are an assumption: by Eq. 3 they give "
    "1080 deg, the next round range above the steering wheel's 1060 deg. The sensor sits with its "
    "zero outside the wheel's range: at zero the difference in Eq. 2 changes its sign by noise "
    "alone, and the angle jumps by the whole range.",
    "Eq. 3 is the range of Eq. 1 only if the small gears differ by their greatest common divisor: "
    "24 and 26 teeth would have 561.6 deg by Eq. 3, and come round after the same only because "
    "they differ by 2, their divisor; 24 and 29 would have 1252.8 deg by Eq. 3 and come round "
    "after 250.6 deg.",
    "Eq. 1 multiplies the noise of the difference by 6. Used only to count the periods of the "
    "first gear, whose own angle then gives the rest, the same two sensors are some thirty times "
    "finer, until the noise puts Eq. 1 into the wrong period (table).",
    "The encoder's 64 pulses are 371 to a turn of the wheel: counted over 100 ms a pulse is "
    "9.7 deg/s, half of the +-20 deg/s that the paper has in its steady state. The time between "
    "edges, which the throttle ECU uses, has no such steps.",
)


def _rows(found: Errors) -> tuple[Row, ...]:
    counted_degps, timed_degps = speed_errors_degps(700.0)
    reaches = Goal("baseline covers the paper's range",
                   lambda row: row.baseline_value >= row.paper_value)  # fmt: skip
    dac_mv = 1000.0 * DAC_REFERENCE_V / (DAC_CODE_MAX + 1)
    steps = round((DAC_FULL_V - DAC_IDLE_V) / DAC_REFERENCE_V * (DAC_CODE_MAX + 1))
    rounds = Goal("ours rounds to the paper's figure", lambda row: round(row.ours_value) == 1)
    figures: tuple[tuple[str, str, str, tuple[float, float, float], tuple[Goal, ...]], ...] = (
        ("adc_step", "step of the ADC", "uV", (7.81, 1e6 * ADC_STEP_V, NAN),
         (baseline_within(0.001),)),
        ("range", "unambiguous range of the angle sensor", "deg",
         (WORKING_RANGE_DEG, GEARS.unambiguous_deg, NAN), (reaches,)),
        ("error", "largest error of the angle over the range", "deg",
         (NAN, found.coarse_deg_max, found.fine_deg_max), (ours_at_most_share(0.1, "baseline"),)),
        ("speed", "largest error of a steady wheel speed of 700 deg/s", "deg/s",
         (20.0, counted_degps, timed_degps),
         (Goal("baseline inside the paper's spread", lambda row: row.baseline_value <= 20.0),
          ours_at_most_share(0.1, "baseline"))),
        ("dac_step", f"step of the DAC ({steps} from idle to full)", "mV", (1.0, NAN, dac_mv),
         (rounds,)),
    )  # fmt: skip
    return tuple(
        Row(id=f"uah.vernier.{name}", paper="uah", quantity=quantity, unit=unit,
            paper_value=values[0], baseline_value=values[1], ours_value=values[2], goals=goals)
        for name, quantity, unit, values, goals in figures
    )  # fmt: skip


def _draw(file: Path, rng: Generator) -> None:
    middle, half = 0.5 * GEARS.range_deg, 0.5 * WORKING_RANGE_DEG
    truth = np.linspace(middle - half, middle + half, 4000)
    first, second = (measured_deg(small, NOISE_V, rng) for small in GEARS.small_angles_deg(truth))
    with picture(file, 6.0, rows=2, columns=2) as axes:
        angles, apart, errors_axis, closer = axes
        shown = slice(0, 500)
        angles.plot(truth[shown] - middle, first[shown], color=OURS, label="24 teeth")
        angles.plot(truth[shown] - middle, second[shown], color=BASELINE, label="25 teeth")
        angles.set_ylabel("small gears, deg")
        angles.legend()
        apart.plot(truth - middle, GEARS.coarse_deg(first, second) - middle, color=BASELINE)
        apart.set_ylabel("angle by Eq. 1, deg")
        for axis, estimate, colour, label in (
            (errors_axis, GEARS.coarse_deg(first, second), BASELINE, "Eq. 1"),
            (closer, GEARS.fine_deg(first, second), OURS, "refined by the first gear"),
        ):
            axis.plot(truth - middle, estimate - truth, color=colour, linewidth=0.5, label=label)
            axis.set_ylabel("error, deg")
            axis.set_xlabel("steering wheel, deg")
            axis.legend(loc="upper right")
