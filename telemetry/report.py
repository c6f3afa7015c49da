"""A drive in numbers: what `report.json` holds."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import Any

UAH_RMSE_M = 0.347
UAH_MAX_ERROR_M = 0.863
"""UAH section 5.2: Pure Pursuit on 800 m of campus with two roundabouts, up to 25 km/h."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalisationNumbers:
    """The planner's satellite receiver as simulated, and what came of it."""

    fix_rate_hz: float
    fix_sigma_m: float
    fix_latency_s: float
    fixes_used: int
    fixes_rejected: int
    error_rms_m: float
    """Estimate against truth when the planner decided; NaN without a decision."""
    error_max_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """The paper's drive, for comparison."""

    source: str = "UAH: Arango et al., Sensors 2020, section 5.2"
    rmse_m: float = UAH_RMSE_M
    max_error_m: float = UAH_MAX_ERROR_M


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveReport:
    """One drive. SI units; NaN, written as null, for what there was nothing to tell from."""

    track: str
    vehicle: str
    bus: str
    """"simulated", or interface and channel."""
    lap_completed: bool
    goal_m: float
    """Way that was asked for; the lap's length for a whole lap."""
    ended_early: str
    """Why the drive ended before its goal; empty when it did not."""
    distance_m: float
    """Driven, from the true positions."""
    duration_s: float
    """From the first decision to the last."""
    rmse_m: float
    """Of the distance between true position and planned line, samples at equal times."""
    max_error_m: float
    speed_max_mps: float
    """True speed."""
    frames: int
    """On the vehicle bus, from power-on to the end."""
    bus_load_mean: float
    bus_load_max: float
    """Over the busiest 100 ms."""
    emergency_brakes: int
    codes: tuple[str, ...]
    real_time_factor: float
    """Time on the bus over time on the wall."""
    seed: int
    trace_sha256: str
    planner_period_ms: float
    steering_lag_s: float
    radius_m_min: float
    """Of the line driven."""
    localisation: LocalisationNumbers
    baseline: Baseline

    def to_json(self) -> str:
        """The report as JSON text, two blanks indented, NaN as null."""
        return json.dumps(without_nan(asdict(self)), indent=2, allow_nan=False) + "\n"


def without_nan(value: Any) -> Any:
    """Plain data with None in place of what JSON has no number for: NaN and infinity."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [without_nan(item) for item in value]
    return value
