"""The system's clock is stepped while the car drives: the nodes live by the monotonic one."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from dbc.messages import Mode
from tests.vcan.stack import Stack, pause


@pytest.fixture
def clock() -> Iterator[None]:
    """Puts the clock right again."""
    begin_s, begin_ns = time.time(), time.monotonic_ns()
    yield
    passed_s = (time.monotonic_ns() - begin_ns) / 1e9
    time.clock_settime(time.CLOCK_REALTIME, begin_s + passed_s)


@pytest.mark.parametrize("step_s", [3600.0, -7200.0])
def test_a_step_of_the_clock_does_not_disturb_a_drive(
    step_s: float, driving: Stack, clock: None
) -> None:
    time.clock_settime(time.CLOCK_REALTIME, time.time() + step_s)
    pause(0.5)
    assert driving.planner.state().mode is Mode.AUTOMATIC, driving.story()
    assert driving.truth().speed_mps > 2.0, driving.story()
