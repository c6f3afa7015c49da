"""Samples of a drive, and the bus written down in wall time."""

from __future__ import annotations

import threading
from typing import Self

import numpy as np
import pytest

from canbus.bus import BusStatistics
from canbus.frame import Frame, ReceivedFrame
from telemetry.bus_log import BusLog
from telemetry.recording import BusRecorder, DriveRecorder

MS = 1_000_000


def test_path_starts_at_zero_and_measures_the_way() -> None:
    recorder = DriveRecorder()
    for number in range(11):
        recorder.add_truth((500 + 20 * number) * MS, 3.0 * number, 4.0 * number, 0.01 * number)
    path = recorder.path()
    assert len(recorder) == 11
    assert path.time_s[0] == 0.0 and path.duration_s == pytest.approx(0.2)
    assert path.distance_m == pytest.approx(50.0)
    assert path.moving.tolist() == [False] * 6 + [True] * 5


def test_samples_after_the_end_are_not_part_of_the_drive() -> None:
    recorder = DriveRecorder()
    recorder.add_truth(0, 0.0, 0.0, 1.0)
    recorder.close()
    recorder.add_truth(1, 1.0, 0.0, 1.0)
    assert len(recorder) == 1


def test_localisation_error_compares_at_the_estimates_own_time() -> None:
    recorder = DriveRecorder()
    for number in range(3):
        recorder.add_truth(number * 100 * MS, 10.0 * number, 0.0, 100.0)
    recorder.add_estimate(50 * MS, 5.0, 0.3)  # exactly half way, 0.3 m beside
    recorder.add_estimate(150 * MS, 15.4, 0.0)  # 0.4 m ahead
    recorder.add_estimate(900 * MS, 0.0, 0.0)  # after the last truth: nothing to compare with
    error = recorder.localisation_error()
    assert error is not None
    assert error.max_m == pytest.approx(0.4)
    assert error.rms_m == pytest.approx(np.sqrt((0.09 + 0.16) / 2))


def test_nothing_recorded_is_no_error_of_zero() -> None:
    recorder = DriveRecorder()
    assert recorder.localisation_error() is None
    assert recorder.path().duration_s == 0.0 and recorder.path().distance_m == 0.0
    recorder.add_truth(0, 0.0, 0.0, 0.0)
    recorder.add_truth(1, 0.0, 0.0, 0.0)
    recorder.add_estimate(5, 0.0, 0.0)
    assert recorder.localisation_error() is None


class ScriptedBus:
    """Hands out one batch, then nothing; tells when it was asked again."""

    def __init__(self, batch: list[ReceivedFrame]) -> None:
        self._batch = batch
        self.is_empty = threading.Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None: ...

    def close(self) -> None: ...

    def send(self, frame: Frame) -> bool:
        raise AssertionError("a recorder sends nothing")

    def gather(self, span_ns: int) -> list[ReceivedFrame]:
        return self.receive(span_ns)

    def receive(self, timeout_ns: int) -> list[ReceivedFrame]:
        batch, self._batch = self._batch, []
        if not batch:
            self.is_empty.set()
            threading.Event().wait(0.001)
        return batch

    @property
    def statistics(self) -> BusStatistics:
        return BusStatistics()


def test_recorder_writes_down_every_frame_with_time_since_its_start() -> None:
    frames = [ReceivedFrame(1_000 + n * MS, Frame(0x100 + n, bytes([n]))) for n in range(5)]
    bus, log = ScriptedBus(frames), BusLog()
    with BusRecorder(bus, lambda: 1_000, log):
        assert bus.is_empty.wait(5.0)
    assert list(log.frames()) == [(item.arrival_ns - 1_000, item.frame) for item in frames]
