"""The measures as tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from bench.socketcan.cost import Cost, CostResult
from bench.socketcan.echo import EchoResult
from bench.socketcan.flood import FloodResult
from bench.socketcan.load import BITRATE_BPS, LOAD, LoadResult
from bench.table import Table, command_line, met

GOAL_RATIO = 1.5
GOAL_SUBJECTS = (2, 3)
"""Of the echoes, those that the goal is about: our runtime."""

EMULATED = (
    "In the virtual machine, with the clock that counts instructions (`dbw vm run --icount 0`): "
    "one processor, 1 ns for every instruction. Ratios count."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SocketcanResult:
    """What `measure` answers.

    Attributes:
        quick: whether it was a tiny one.
        is_emulated: whether it was measured in the virtual machine.
        measured: results by part.
    """

    quick: bool
    is_emulated: bool
    measured: dict[str, Any]

    def tables(self) -> list[Table]:
        """One table or two for each part."""
        makers: dict[str, Callable[[Any], list[tuple[str, _Rows]]]] = {
            "echo": _echo, "flood": _flood, "cost": _cost, "load": _load,
        }
        return [
            Table(
                title=title,
                command=command_line("socketcan", quick=self.quick),
                headers=rows.headers,
                rows=rows.rows,
                notes=[*rows.notes, *[EMULATED] * self.is_emulated],
            )
            for name, result in self.measured.items()
            for title, rows in makers[name](result)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rows:
    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()


def _echo(results: Sequence[EchoResult]) -> list[tuple[str, _Rows]]:
    reference_us = results[0].percentile_us(50)
    rows = []
    for number, result in enumerate(results):
        median_us = result.percentile_us(50)
        ratio = median_us / reference_us
        goal = met(ratio <= GOAL_RATIO) if number in GOAL_SUBJECTS else ""
        rows.append(
            (result.name, f"{median_us:.1f}", f"{result.percentile_us(99):.1f}", f"{ratio:.2f}",
             goal)
        )
    notes = (
        f"{len(results[0].spans_ns)} requests each on vcan0, by the kernel's stamps on request and "
        "answer. A node in its cycle answers at its next step: the wait for that, up to 10 ms, is "
        "left out; reading the request is not. A node's step holds all its other work too, its "
        "control loop included; the answer is the first frame that it sends.",
    )
    headers = ("who answers", "median, us", "99 %", "to python-can", f"goal <= {GOAL_RATIO:g}")
    return [("From a frame to the answer to it", _Rows(headers=headers, rows=rows, notes=notes))]


def _flood(results: Sequence[FloodResult]) -> list[tuple[str, _Rows]]:
    reference = results[0].frames_per_s
    rows = [
        (result.name, f"{result.cpu_s / result.frames * 1e6:.2f}", f"{result.frames_per_s:,.0f}",
         f"{result.frames_per_s / reference:.3f}")
        for result in results
    ]
    notes = (
        f"The same {results[0].frames} frames of `cangen -g 0`, sent as fast as it can, to all "
        "three at once; their queues have room for all of them, and each got every frame.",
    )
    headers = ("reader", "us per frame", "frames/s of one processor", "to candump")
    return [("Reading a flood", _Rows(headers=headers, rows=rows, notes=notes))]


def _cost(result: CostResult) -> list[tuple[str, _Rows]]:
    rows = [_cost_row(cost) for cost in result.costs]
    notes = (
        f"{result.span_s:g} s each; {result.frames_per_s:.0f} frames/s on the vehicle bus. The "
        "planner's process holds the gateway, `plant` is the simulated car, and beside them the "
        "smallest python-can loop receives every frame and does nothing. Memory is what `dbw ecu` "
        "has resident, shared libraries included.",
    )
    headers = ("process", "MANUAL, % of a processor", "us per cycle", "AUTOMATIC, %",
               "us per cycle", "memory, MiB")
    return [("Processor time and memory", _Rows(headers=headers, rows=rows, notes=notes))]


def _cost_row(cost: Cost) -> tuple[str, ...]:
    return (
        cost.name,
        f"{cost.rest_ratio:.1%}", f"{cost.per_cycle_us(cost.rest_ratio):.0f}",
        f"{cost.drive_ratio:.1%}", f"{cost.per_cycle_us(cost.drive_ratio):.0f}",
        "" if cost.resident_mib is None else f"{cost.resident_mib:.0f}",
    )


def _load(result: LoadResult) -> list[tuple[str, _Rows]]:
    return [_load_summary(result), _load_periods(result)]


def _load_summary(result: LoadResult) -> tuple[str, _Rows]:
    log = result.log
    lost = sum(stream.lost or 0 for stream in log.streams.values())
    overruns = result.overruns.values()
    count, skipped = sum(each.count for each in overruns), sum(each.skipped for each in overruns)
    late_ms_max = max((each.late_ms_max for each in overruns), default=0.0)
    rows = [
        ("time, min", f"{result.span_s / 60:.1f}", ""),
        (f"load of {BITRATE_BPS / 1000:g} kbit/s", f"{result.load:.1%}",
         met(abs(result.load - LOAD) < 0.02)),
        ("frames of ours; of strangers", f"{log.frames:,}; {result.strangers:,}", ""),
        ("frames of ours lost, by alive counters", str(lost), met(lost == 0)),
        ("frames dropped by the kernel", str(result.kernel_drops), met(not result.kernel_drops)),
        ("losses reported by nodes", str(len(result.losses)), met(not result.losses)),
        ("EMERGENCY_BRAKE frames", str(log.brakes), met(not log.brakes)),
        ("AUTOMATIC to the end; driven", f"{result.distance_m:.0f} m", met(result.is_automatic)),
        ("overruns; cycles skipped; latest cycle", f"{count}; {skipped}; {late_ms_max:.1f} ms",
         "counted"),
    ]
    notes = (
        "The car drives a serpentine at 4 m/s by the gateway's API; the load is that of all "
        "frames' exact lengths, stuff bits in. vcan carries frames at once: this measures nodes "
        "and computer under load, not the wire's arbitration.",
        *result.losses,
    )
    headers = ("", "measured", "")
    return "The whole stack on a full bus", _Rows(headers=headers, rows=rows, notes=notes)


def _load_periods(result: LoadResult) -> tuple[str, _Rows]:
    rows = [
        (f"0x{can_id:03X}", stream.name, f"{stream.cycle_ms:g}", str(stream.frames),
         "" if stream.lost is None else str(stream.lost),
         *(f"{period_ms:.2f}" for period_ms in stream.periods_ms))
        for can_id, stream in result.log.streams.items()
    ]
    headers = ("id", "message", "period, ms", "frames", "lost", "median distance, ms", "99 %",
               "longest")
    return "Our frames on it", _Rows(headers=headers, rows=rows)
