"""Stand-ins for clock, bus, node and hardware: no threads, no waiting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Self

from canbus.bus import BusStatistics
from canbus.frame import Frame, ReceivedFrame
from canbus.node import StepOutput

MS = 1_000_000


class FakeClock:
    """Stands still until it is moved."""

    def __init__(self, now_ns: int = 0) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        return self.now_ns


class FakeBus:
    """A bus whose traffic is known beforehand; waiting moves the clock."""

    def __init__(self, clock: FakeClock, incoming: Sequence[tuple[int, Frame]] = ()) -> None:
        self._clock = clock
        self.incoming = sorted(incoming, key=lambda item: item[0])
        self.sent: list[tuple[int, Frame]] = []
        self.refuses = False
        self.refused = 0
        self.rx_lost = 0
        self.error_frames = 0
        self.waits: list[int] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def send(self, frame: Frame) -> bool:
        self.refused += self.refuses
        if not self.refuses:
            self.sent.append((self._clock.now_ns, frame))
        return not self.refuses

    def gather(self, span_ns: int) -> list[ReceivedFrame]:
        return self.receive(span_ns)

    def receive(self, timeout_ns: int) -> list[ReceivedFrame]:
        self.waits.append(timeout_ns)
        end_ns = self._clock.now_ns + timeout_ns
        if self.incoming and self.incoming[0][0] <= end_ns:
            self._clock.now_ns = max(self._clock.now_ns, self.incoming[0][0])
        else:
            self._clock.now_ns = end_ns
        now_ns = self._clock.now_ns
        due = [item for item in self.incoming if item[0] <= now_ns]
        self.incoming = self.incoming[len(due) :]
        return [ReceivedFrame(arrival_ns, frame) for arrival_ns, frame in due]

    @property
    def statistics(self) -> BusStatistics:
        return BusStatistics(
            sent=len(self.sent), tx_failures=self.refused, rx_lost=self.rx_lost,
            error_frames=self.error_frames, error_classes=0x0A0,
        )

    def close(self) -> None:
        pass


class FakePort:
    """Hardware that remembers what it was told."""

    def __init__(self) -> None:
        self.polls = 0
        self.actuated: list[tuple[int, Any]] = []

    def poll(self) -> None:
        self.polls += 1

    def sensors(self, now_ns: int) -> int:
        return now_ns

    def actuate(self, now_ns: int, actuator: Any) -> None:
        self.actuated.append((now_ns, actuator))


class FakeNode:
    """Remembers its steps; `on_step` may do anything and answer a step's output."""

    name = "Steering"
    acceptance: frozenset[int] | None = None

    def __init__(self, on_step: Callable[[int], StepOutput[Any] | None] = lambda now: None) -> None:
        self._on_step = on_step
        self.steps: list[tuple[int, list[ReceivedFrame], Any]] = []

    def step(self, now_ns: int, received: Sequence[ReceivedFrame], sensors: Any) -> StepOutput[Any]:
        self.steps.append((now_ns, list(received), sensors))
        output = self._on_step(now_ns)
        return output or StepOutput(frames=(), actuator="hold", events=())


class StopAt:
    """A stop flag that is set once the clock has come to a time."""

    def __init__(self, clock: FakeClock, stop_ns: int) -> None:
        self._clock = clock
        self._stop_ns = stop_ns

    def is_set(self) -> bool:
        return self._clock.now_ns >= self._stop_ns
