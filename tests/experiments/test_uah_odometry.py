"""A car that knows its way by the wheels alone."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.uah.odometry import NEAR_M, SIGMAS, lap_by_wheels
from experiments.uah.path import campus_plan

pytestmark = pytest.mark.whole_car


def test_the_truth_stays_within_the_stated_error_and_a_third_of_it_would_be_too_little() -> None:
    lap = lap_by_wheels(campus_plan(60.0), seed=3)
    far = lap.way_m > NEAR_M
    shares = lap.error_m[far] / lap.position_sigma_m[far]
    assert lap.way_m[-1] > 55.0
    assert shares[-1] > 1.0 / 3.0 and shares.max() < SIGMAS
    headings = abs(lap.heading_error_rad[far]) / lap.heading_sigma_rad[far]
    assert headings.max() < SIGMAS
    assert np.all(np.diff(lap.position_sigma_m) > -1e-6)
