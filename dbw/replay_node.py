"""`dbw replay --through`: a node's code on its recorded inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, Final

import click

from dbw.failures import EXIT_FAILED, EXIT_OK, UserMistake

if TYPE_CHECKING:
    from collections import Counter

    from dbw.replay import ReplayOptions
    from telemetry.logs.frames import FrameColumns
    from telemetry.replay.comparison import Difference, Match
    from telemetry.replay.through_node import NodeReplay

NS_PER_S: Final = 1_000_000_000
SHOWN_MAX: Final = 20


def run_through(options: ReplayOptions, chunks: Callable[[], Iterator[FrameColumns]]) -> int:
    """Replays and tells; answers the exit code, 1 if the node does not do what the record says."""
    from runtime.nodes import NODES, build_node, build_wires
    from telemetry.logs.frames import origin_ns
    from telemetry.replay.source import record_of
    from telemetry.replay.through_node import replay_node
    from vehicles import load_vehicle

    assert options.through is not None
    name = options.through
    if name not in NODES:
        raise UserMistake(
            f"--through {name}: allowed {', '.join(NODES)}; what a planner asks of its gateway is "
            "on no bus"
        )
    entry = NODES[name]
    vehicle = load_vehicle(options.vehicle)
    frames = (frame for chunk in chunks() for frame in chunk.frames())
    record = record_of(frames, options.channel, options.harness_channel)
    outcome = replay_node(
        entry.node, record, lambda: build_node(name, vehicle), lambda: build_wires(name)
    )
    _tell(outcome, origin_ns(record.vehicle_bus[0].arrival_ns))
    return EXIT_OK if outcome.is_equal else EXIT_FAILED


def _tell(outcome: NodeReplay, zero_ns: int) -> None:
    first_s, last_s = ((outcome.steps[n].now_ns - zero_ns) / NS_PER_S for n in (0, -1))
    click.echo(f"{outcome.node}: {len(outcome.steps)} steps, {first_s:.3f} s to {last_s:.3f} s")
    for number in outcome.restarts:
        time_s = (outcome.steps[number].now_ns - zero_ns) / NS_PER_S
        click.echo(f"  started again at {time_s:.3f} s")
    for comparison in (outcome.vehicle_bus, outcome.harness):
        for message, counts in comparison.counts.items():
            click.echo(f"  {message:<32} {_counts(counts)}")
    differences = [*outcome.vehicle_bus.differences, *outcome.harness.differences]
    differences.sort(key=lambda one: one.time_ns)
    for difference in differences[:SHOWN_MAX]:
        click.echo(_line(difference, zero_ns))
    if len(differences) > SHOWN_MAX:
        click.echo(f"and {len(differences) - SHOWN_MAX} more differences")
    does = "does not do" if differences else "does"
    click.echo(f"the code {does} what the record says")


def _counts(counts: Counter[Match]) -> str:
    return ", ".join(f"{count} {match}" for match, count in counts.most_common())


def _line(difference: Difference, zero_ns: int) -> str:
    time_s = (difference.time_ns - zero_ns) / NS_PER_S
    frames = (("recorded", difference.recorded), ("here", difference.replayed))
    bytes_text = ", ".join(f"{what} {frame}" for what, frame in frames if frame is not None)
    return (
        f"{time_s:12.3f} s  {difference.name} {difference.match}: "
        f"{_signals(difference.signals) or bytes_text}"
    )


def _signals(signals: Mapping[str, tuple[Any, Any]]) -> str:
    return ", ".join(
        f"{name} recorded {_value(was)}, here {_value(now)}"
        for name, (was, now) in signals.items()
    )


def _value(value: Any) -> str:
    if isinstance(value, Enum):
        return value.name
    return f"{value:.10g}" if isinstance(value, float) else f"{value}"
