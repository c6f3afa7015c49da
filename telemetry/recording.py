"""What is noted while the car drives: where it truly is, where the planner thinks it is."""

from __future__ import annotations

import threading
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from canbus.bus import Bus
from telemetry.bus_log import BusLog

FloatArray = NDArray[np.float64]

RECEIVE_NS: Final = 50_000_000
"""How long the recorder waits for frames before it looks whether it is over."""

STANDSTILL_MPS: Final = 0.05
"""Slower samples count as standing: they are left out of a drive's errors."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """True poses at equal times; arrays of shape (N,)."""

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    speed_mps: FloatArray

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which samples are of a car that moves."""
        result: NDArray[np.bool_] = np.abs(self.speed_mps) > STANDSTILL_MPS
        return result

    @property
    def distance_m(self) -> float:
        """Way between the samples."""
        return float(np.hypot(np.diff(self.x_m), np.diff(self.y_m)).sum())

    @property
    def duration_s(self) -> float:
        """Time between the first sample and the last; 0 without any."""
        return float(self.time_s[-1] - self.time_s[0]) if len(self.time_s) else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalisationError:
    """Distance between the planner's estimate and the true position, when it decided."""

    rms_m: float
    max_m: float


class DriveRecorder:
    """Takes samples while the car is driven; times are those of one clock, in ns."""

    def __init__(self) -> None:
        self._truth = {name: array("d") for name in ("time", "x", "y", "speed")}
        self._estimate = {name: array("d") for name in ("time", "x", "y")}
        self._is_closed = False

    def __len__(self) -> int:
        """True poses so far."""
        return len(self._truth["time"])

    def add_truth(self, time_ns: int, x_m: float, y_m: float, speed_mps: float) -> None:
        """Notes the true position of the rear axle's centre."""
        if self._is_closed:
            return
        truth = self._truth
        truth["time"].append(time_ns / 1e9)
        truth["x"].append(x_m)
        truth["y"].append(y_m)
        truth["speed"].append(speed_mps)

    def close(self) -> None:
        """The drive is over: true poses that still come are not part of it."""
        self._is_closed = True

    def add_estimate(self, time_ns: int, x_m: float, y_m: float) -> None:
        """Notes where the planner believes the same point to be."""
        estimate = self._estimate
        estimate["time"].append(time_ns / 1e9)
        estimate["x"].append(x_m)
        estimate["y"].append(y_m)

    def path(self) -> Path:
        """The true poses; time begins at 0."""
        time, x, y, speed = (np.array(column) for column in self._truth.values())
        if len(time):
            time = time - time[0]
        return Path(time_s=time, x_m=x, y_m=y, speed_mps=speed)

    def localisation_error(self) -> LocalisationError | None:
        """How far off the estimates were; None without estimates between true poses."""
        time, x, y, _ = (np.array(column) for column in self._truth.values())
        at, x_estimated, y_estimated = (np.array(column) for column in self._estimate.values())
        if len(time) < 2:
            return None
        known = (at >= time[0]) & (at <= time[-1])
        if not known.any():
            return None
        dx = x_estimated[known] - np.interp(at[known], time, x)
        dy = y_estimated[known] - np.interp(at[known], time, y)
        distance = np.hypot(dx, dy)
        return LocalisationError(
            rms_m=float(np.sqrt(np.mean(distance**2))), max_m=float(distance.max())
        )


class BusRecorder:
    """Writes down a bus in wall time, in a thread of its own, for as long as `with` lasts.

    Args:
        bus: The bus, open, without an acceptance filter.
        clock: The bus's clock.
        log: Where the frames go; times count from the start of the recorder.
    """

    def __init__(self, bus: Bus, clock: Callable[[], int], log: BusLog) -> None:
        self._bus = bus
        self._clock = clock
        self._log = log
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bus-recorder", daemon=True)
        self._start_ns = 0

    def __enter__(self) -> Self:
        """Starts the thread."""
        self._start_ns = self._clock()
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stops and joins it."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.is_set():
            for item in self._bus.receive(RECEIVE_NS):
                self._log.add(max(0, item.arrival_ns - self._start_ns), item.frame)
