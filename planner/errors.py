"""Cross-track error of a driven trace against a line, and whether it was a whole lap."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planner.line import Line
from planner.road import FloatArray
from planner.tracker import LineTracker

LAP_TOLERANCE_M = 2.0  # the stop at the line's end may fall this short


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackingErrors:
    """How a trace followed a line.

    Attributes:
        lateral_m: Signed distance from the line, left positive, shape (N,) of the trace.
        progress_m: Place along the line, not wrapped, shape (N,).
        lap_m: Length of one lap.
    """

    lateral_m: FloatArray
    progress_m: FloatArray
    lap_m: float

    @property
    def rmse_m(self) -> float:
        """Root mean square of the lateral error, each sample counting the same.

        With samples at equal times the slow places, which are the bends, weigh more than they
        would per metre. Leave out standing time before calling, or it counts as perfect driving.
        """
        return math.sqrt(float(np.mean(self.lateral_m**2)))

    @property
    def max_error_m(self) -> float:
        """Largest distance from the line."""
        return float(np.abs(self.lateral_m).max())

    @property
    def lap_completed(self) -> bool:
        """True if the trace starts near s = 0 and reaches the line's end, to within 2 m."""
        reached_m = float(self.progress_m.max())
        return (
            abs(float(self.progress_m[0])) <= LAP_TOLERANCE_M
            and reached_m >= self.lap_m - LAP_TOLERANCE_M
        )


def tracking_errors(line: Line, x_m: ArrayLike, y_m: ArrayLike) -> TrackingErrors:
    """Return the errors of a trace of true positions that starts near the line's start.

    Neighbouring samples may lie up to 12 m apart.

    Raises:
        ValueError: If the trace is empty, its two arrays differ in length, or a number is not
            finite.
    """
    x = np.asarray(x_m, dtype=np.float64)
    y = np.asarray(y_m, dtype=np.float64)
    if x.ndim != 1 or x.shape != y.shape or len(x) == 0:
        raise ValueError(f"x_m {x.shape} and y_m {y.shape} must be one equal, non-empty length")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("x_m and y_m must be finite")
    tracker = LineTracker(line)
    lateral = np.empty(len(x))
    progress = np.empty(len(x))
    for index, (x_now, y_now) in enumerate(zip(x.tolist(), y.tolist(), strict=True)):
        tracker.advance(x_now, y_now)
        lateral[index] = tracker.lateral_m
        progress[index] = tracker.progress_m
    return TrackingErrors(lateral_m=lateral, progress_m=progress, lap_m=line.length_m)
