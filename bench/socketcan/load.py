"""The whole stack drives for minutes on a bus that strangers fill to 90 %."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

from bench.socketcan.buslog import BusLog, read_bus_log
from bench.socketcan.drive import CHANNEL, Drive, pause
from bench.socketcan.nodelog import Overruns, read_losses, read_overruns
from bench.socketcan.traffic import STRANGER_BITS, STRANGERS, Strangers, gap_ms, statistic
from dbc.messages import Mode

BITRATE_BPS = 500_000
LOAD = 0.9
SPAN_S, QUICK_SPAN_S = 600.0, 2.0
LEG_S = 30.0
"""After each, progress is told."""

OURS_ALONE = f"{CHANNEL},400~700"
"""candump's filter: everything but 0x400 to 0x4FF."""

CALIBRATION_S = 2.0
TELL_S = 1.1
"""Nodes report overruns and losses at most once a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadResult:
    """What came of it.

    Attributes:
        span_s: the measured time, the guest's.
        log: our own frames in that time.
        strangers: frames of others in that time.
        is_automatic: whether the car was still driving itself at the end.
        distance_m: driven.
        overruns: of nodes that had any.
        losses: what nodes reported about lost or refused frames.
        kernel_drops: of the network, both directions.
    """

    span_s: float
    log: BusLog
    strangers: int
    is_automatic: bool
    distance_m: float
    overruns: dict[str, Overruns]
    losses: tuple[str, ...]
    kernel_drops: int

    @property
    def load(self) -> float:
        """Share of the bus, by the frames' exact lengths."""
        bits = self.log.bits + self.strangers * STRANGER_BITS
        return bits / (self.span_s * BITRATE_BPS)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Moment:
    """The system's clock, frames on the vehicle bus so far, and what the nodes have said."""

    time_s: float
    frames: int
    said: str


def measure_load(*, quick: bool = False) -> LoadResult:
    """Needs vcan0 and vcan1."""
    span_s = QUICK_SPAN_S if quick else SPAN_S
    with Drive(OURS_ALONE) as drive:
        drive.engage()
        with Strangers(CHANNEL, _pause_ms(drive)):
            pause(CALIBRATION_S)
            begin, before = _now(drive), drive.ask()
            after = before
            while (left_s := begin.time_s + span_s - time.time()) > 0:
                pause(min(left_s, LEG_S))
                after = drive.ask()
                sys.stderr.write(f"{left_s:.0f} s left: {after}\n")
                if after.mode is not Mode.AUTOMATIC:
                    break  # what a standing car does on a full bus is no answer
            end = _now(drive)
            pause(TELL_S)
        during = drive.said[len(begin.said) :]
        log = _bus_log(drive, begin, end)
        if after.mode is not Mode.AUTOMATIC:
            sys.stderr.write(f"{drive.story}\n")
    return LoadResult(
        span_s=end.time_s - begin.time_s,
        log=log,
        strangers=end.frames - begin.frames - log.frames,
        is_automatic=after.mode is Mode.AUTOMATIC,
        distance_m=after.distance_m - before.distance_m,
        overruns=read_overruns(begin.said, during),
        losses=tuple(read_losses(during)),
        kernel_drops=statistic(CHANNEL, "rx_dropped") + statistic(CHANNEL, "tx_dropped"),
    )


def _now(drive: Drive) -> _Moment:
    return _Moment(
        time_s=time.time(), frames=statistic(CHANNEL, "tx_packets"), said=drive.said
    )


def _bus_log(drive: Drive, begin: _Moment, end: _Moment) -> BusLog:
    with drive.bus_log.open(encoding="ascii") as lines:
        return read_bus_log(lines, begin.time_s, end.time_s)


def _pause_ms(drive: Drive) -> float:
    """What each stranger must wait; the time that `cangen` itself takes is measured."""
    begin = _now(drive)
    pause(CALIBRATION_S)
    end = _now(drive)
    span_s = end.time_s - begin.time_s
    own = _bus_log(drive, begin, end)
    wanted_ms = gap_ms(LOAD, own.bits / span_s, BITRATE_BPS)
    with Strangers(CHANNEL, wanted_ms):
        pause(CALIBRATION_S / 4)
        middle = _now(drive)
        pause(CALIBRATION_S)
        last = _now(drive)
    foreign_per_s = (last.frames - middle.frames) / (last.time_s - middle.time_s)
    real_ms = 1e3 * len(STRANGERS) / (foreign_per_s - own.frames / span_s)
    sys.stderr.write(
        f"our own: {own.frames / span_s:.0f} frames/s, {own.bits / span_s / BITRATE_BPS:.1%} of "
        f"the bus; cangen: every {real_ms:.3f} ms for {wanted_ms:.3f} ms\n"
    )
    return max(0.0, 2 * wanted_ms - real_ms)
