"""The recorded inputs of one node fed to its code in virtual time, its outputs beside the record.

What a node knew is on two buses: the vehicle bus, and the harness that stands for the wires of its
sensors. With both in a log, the node can be run again, step by step. What is not in a log is when
exactly a step began: `steps.py` infers it from what the node sent.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from canbus.frame import Frame, FrameKind, ReceivedFrame
from canbus.node import EARS_NS, Node
from dbc.endpoint import sent_by
from dbc.harness import SPECS as HARNESS_SPECS
from dbc.messages import SPECS
from telemetry.replay.comparison import Comparison, resolutions_of
from telemetry.replay.steps import Step, boot_up_of, cyclic_id, find_steps


class ReplayError(ValueError):
    """A log that a node cannot be replayed from; one line with the reason."""


class Wires(Protocol):
    """The node's share of the harness: `runtime.wires`."""

    @property
    def acceptance(self) -> frozenset[int]:
        """Identifiers of the harness bus that the node reads."""
        ...

    def take(self, received: Sequence[ReceivedFrame]) -> None:
        """Takes in frames of the harness bus."""
        ...

    def sensors(self, now_ns: int) -> Any:
        """Readings as they are to be believed now."""
        ...

    def frames(self, actuator: Any) -> list[Frame]:
        """The frames that carry a command to the plant."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """The two buses of a log, each in order of time."""

    vehicle_bus: Sequence[ReceivedFrame]
    harness: Sequence[ReceivedFrame]


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeReplay:
    """What came of it.

    Attributes:
        node: The DBC's name.
        steps: In order.
        restarts: Steps at which the node was started again.
        vehicle_bus, harness: The comparison of what it sent on either.
    """

    node: str
    steps: Sequence[Step]
    restarts: Sequence[int]
    vehicle_bus: Comparison
    harness: Comparison

    @property
    def is_equal(self) -> bool:
        """Whether the code did what the record says."""
        return self.vehicle_bus.is_equal and self.harness.is_equal


def replay_node(
    node: str,
    record: Record,
    build: Callable[[], Node[Any, Any]],
    wire: Callable[[], Wires],
) -> NodeReplay:
    """Runs a node through a record.

    Args:
        node: The DBC's name.
        record: Its buses.
        build: Makes the node, as it is after power-on.
        wire: Makes its share of the harness.

    Raises:
        ReplayError: The node is not started in this log: what it remembers is not known.
    """
    commands = [item for item in record.harness if item.frame.can_id in _commands_of(node)]
    steps = find_steps(node, record.vehicle_bus, commands)
    if not steps:
        raise ReplayError(
            f"the log does not hold the start of {node} (its boot-up, {boot_up_of(node)}), so what "
            "it remembered is not known: record from before the node is started"
        )
    run = _Run(node, record, commands, steps, build, wire)
    run.run()
    times_ns = [step.now_ns for step in steps]
    vehicle_bus = Comparison(SPECS, resolutions_of("vehicle"))
    harness = Comparison(HARNESS_SPECS, resolutions_of("harness"))
    vehicle_bus.add(times_ns, run.recorded, run.sent)
    harness.add(times_ns, run.actuated, run.commands)
    return NodeReplay(
        node=node, steps=steps, restarts=run.restarts, vehicle_bus=vehicle_bus, harness=harness
    )


class _Run:
    """One pass over all steps."""

    def __init__(
        self,
        node: str,
        record: Record,
        commands: Sequence[ReceivedFrame],
        steps: Sequence[Step],
        build: Callable[[], Node[Any, Any]],
        wire: Callable[[], Wires],
    ) -> None:
        self._build = build
        self._wire = wire
        self._steps = steps
        self._boot_up = boot_up_of(node)
        self._node, self._wires = build(), wire()
        times_ns = [step.now_ns for step in steps]
        own = sent_by(node)
        seen = {step.frame_ns for step in steps}
        cyclic = cyclic_id(node)
        inputs = [i for i in record.vehicle_bus if self._is_input(i, own, cyclic, seen)]
        strangers = {id(item) for item in inputs}
        self.recorded = _cut(
            times_ns,
            [i for i in record.vehicle_bus if i.frame.can_id in own and id(i) not in strangers],
        )
        self._inputs = _before(times_ns, inputs)
        self.actuated = _cut(times_ns, commands)
        wanted = self._wires.acceptance
        self._readings = _before(
            times_ns, [i for i in record.harness if i.frame.can_id in wanted]
        )
        self.sent: list[Sequence[Frame]] = []
        self.commands: list[Sequence[Frame]] = []
        self.restarts: list[int] = []

    def run(self) -> None:
        """All steps in order; a node that was started anew in the record is so here."""
        for number, step in enumerate(self._steps):
            is_boot = self._boot_up in self.recorded[number]
            since_ns = step.now_ns - EARS_NS if number == 0 else 0
            output = self._node.step(step.now_ns, *self._given(number, since_ns))
            if is_boot and self._boot_up not in output.frames:
                self._node, self._wires = self._build(), self._wire()
                output = self._node.step(step.now_ns, *self._given(number, step.now_ns - EARS_NS))
                self.restarts.append(number)
            self.sent.append(output.frames)
            has_command = output.actuator is not None
            self.commands.append(self._wires.frames(output.actuator) if has_command else ())

    def _given(self, number: int, since_ns: int) -> tuple[Sequence[ReceivedFrame], Any]:
        """What the node has heard for a step, nothing of it before `since_ns`, and its sensors."""
        self._wires.take(self._readings[number])  # the newest counts, if it is not stale
        heard = [item for item in self._inputs[number] if item.arrival_ns >= since_ns]
        return heard, self._wires.sensors(self._steps[number].now_ns)

    def _is_input(
        self, item: ReceivedFrame, own: frozenset[int], cyclic: int, seen: set[int | None]
    ) -> bool:
        """Whether the node heard this frame: others' that it wants, and strangers' in its name.

        Of the messages in the node's own name only a cyclic one can be told a stranger's.
        """
        frame = item.frame
        if frame.kind is FrameKind.ERROR:
            return True
        acceptance = self._node.acceptance
        if acceptance is not None and frame.can_id not in acceptance:
            return False
        if frame.can_id not in own:
            return True
        return frame.can_id == cyclic and item.arrival_ns not in seen


def _commands_of(node: str) -> frozenset[int]:
    """Identifiers of what a node tells its actuator over the harness."""
    return frozenset(spec.can_id for spec in HARNESS_SPECS.values() if spec.sender == node)


def _before(times_ns: Sequence[int], items: Sequence[ReceivedFrame]) -> list[list[ReceivedFrame]]:
    """What has arrived when each step begins, and had not at the step before."""
    arrivals = [item.arrival_ns for item in items]
    ends = [bisect_left(arrivals, now_ns) for now_ns in times_ns]
    return [list(items[start:end]) for start, end in zip([0, *ends], ends, strict=False)]


def _cut(times_ns: Sequence[int], items: Sequence[ReceivedFrame]) -> list[list[Frame]]:
    """What was sent from each step on, and before the next."""
    arrivals = [item.arrival_ns for item in items]
    starts = [bisect_left(arrivals, now_ns) for now_ns in times_ns]
    return [
        [item.frame for item in items[start:end]]
        for start, end in zip(starts, [*starts[1:], len(items)], strict=True)
    ]
