"""The loop that runs one node, under a clock that only waiting moves."""

from __future__ import annotations

from typing import Any

from canbus.frame import Frame
from canbus.node import Event, EventKind, StepOutput
from runtime.node_process import NodeResult, run_node
from tests.runtime.runtime_fakes import MS, FakeBus, FakeClock, FakeNode, FakePort, StopAt


def run(
    node: FakeNode,
    *,
    clock: FakeClock,
    bus: FakeBus,
    port: FakePort | None = None,
    stop_ns: int = 105 * MS,
    phase_ns: int = 0,
) -> tuple[NodeResult, list[Event]]:
    events: list[Event] = []
    result = run_node(
        node,
        bus,
        port or FakePort(),
        clock,
        StopAt(clock, stop_ns),
        events.append,
        phase_ns=phase_ns,
    )
    return result, events


def test_node_steps_at_its_phase_of_every_period() -> None:
    clock, node = FakeClock(), FakeNode()
    result, events = run(node, clock=clock, bus=FakeBus(clock), phase_ns=3 * MS)
    assert [step[0] for step in node.steps] == [(3 + 10 * n) * MS for n in range(11)]
    assert result.exit_code == 0 and result.failure is None and not events


def test_every_frame_reaches_the_next_step_with_its_own_arrival_time() -> None:
    clock, node = FakeClock(), FakeNode()
    frames = [(t, Frame(0x100 + t // MS)) for t in (1 * MS, 4 * MS, 10 * MS, 17 * MS)]
    run(node, clock=clock, bus=FakeBus(clock, frames), stop_ns=25 * MS)
    assert [[(i.arrival_ns, i.frame.can_id) for i in got] for _, got, _ in node.steps] == [
        [(1 * MS, 0x101), (4 * MS, 0x104), (10 * MS, 0x10A)],
        [(17 * MS, 0x111)],
    ]


def test_the_first_step_hears_the_cycle_before_it_and_nothing_older() -> None:
    clock, node = FakeClock(), FakeNode()
    bus = FakeBus(clock, [(t, Frame(t // MS)) for t in (1 * MS, 12 * MS, 13 * MS, 22 * MS)])
    clock.now_ns = 14 * MS  # it opened its bus long ago, and begins to step
    run(node, clock=clock, bus=bus, stop_ns=35 * MS, phase_ns=2 * MS)
    heard = [(now, [item.frame.can_id for item in got]) for now, got, _ in node.steps]
    assert heard == [(22 * MS, [12, 13, 22]), (32 * MS, [])]


def test_readings_are_taken_at_the_time_of_the_step() -> None:
    clock, node = FakeClock(), FakeNode()
    run(node, clock=clock, bus=FakeBus(clock))
    assert all(sensors == now_ns for now_ns, _, sensors in node.steps)


def test_port_is_polled_whenever_a_frame_wakes_the_node() -> None:
    clock, port = FakeClock(), FakePort()
    bus = FakeBus(clock, [(t * MS, Frame(1)) for t in (2, 5, 7)])
    run(FakeNode(), clock=clock, bus=bus, port=port, stop_ns=10 * MS)
    assert port.polls == 4  # three frames and the wait that ends at the deadline


def test_a_node_that_is_told_to_end_while_it_waits_steps_no_more() -> None:
    clock, node, port = FakeClock(), FakeNode(), FakePort()
    run(node, clock=clock, bus=FakeBus(clock), port=port, stop_ns=20 * MS)
    assert [step[0] for step in node.steps] == [10 * MS]


def test_node_waits_for_the_deadline_in_one_piece() -> None:
    clock = FakeClock(2 * MS)
    bus = FakeBus(clock)
    run(FakeNode(), clock=clock, bus=bus, stop_ns=20 * MS)
    assert bus.waits == [8 * MS, 10 * MS]


def test_frames_and_command_leave_in_the_step_they_belong_to() -> None:
    clock, port = FakeClock(), FakePort()
    node = FakeNode(lambda now: StepOutput(frames=[Frame(0x182)], actuator=now, events=()))
    bus = FakeBus(clock)
    run(node, clock=clock, bus=bus, port=port, stop_ns=25 * MS)
    assert bus.sent == [(10 * MS, Frame(0x182)), (20 * MS, Frame(0x182))]
    assert port.actuated == [(10 * MS, 10 * MS), (20 * MS, 20 * MS)]


def test_events_are_handed_on() -> None:
    clock = FakeClock()
    event = Event(time_ns=1, node="Steering", kind=EventKind.MODE, text="MANUAL")
    node = FakeNode(lambda now: StepOutput(frames=(), actuator=None, events=[event]))
    _, events = run(node, clock=clock, bus=FakeBus(clock), stop_ns=15 * MS)
    assert events == [event]


def test_step_that_takes_too_long_is_counted_reported_and_not_caught_up() -> None:
    clock = FakeClock()

    def work(now_ns: int) -> None:
        clock.now_ns += 33 * MS if now_ns == 10 * MS else 0

    node = FakeNode(work)
    result, events = run(node, clock=clock, bus=FakeBus(clock), stop_ns=75 * MS)
    assert [step[0] for step in node.steps] == [10 * MS, 50 * MS, 60 * MS, 70 * MS]
    assert (result.overruns, result.skipped, result.steps) == (1, 3, 4)
    assert [event.kind for event in events] == [EventKind.OVERRUN]
    assert "1 overruns and 3 skipped" in events[0].text


def test_overruns_are_reported_once_a_second_with_all_of_them_counted() -> None:
    clock = FakeClock()

    def work(now_ns: int) -> None:
        clock.now_ns += 12 * MS

    result, events = run(FakeNode(work), clock=clock, bus=FakeBus(clock), stop_ns=2_500 * MS)
    assert result.overruns > 100
    assert len(events) == 3


def test_refused_frames_are_counted_and_reported() -> None:
    clock = FakeClock()
    bus = FakeBus(clock)
    bus.refuses = True
    node = FakeNode(lambda now: StepOutput(frames=[Frame(1), Frame(2)], actuator=None, events=()))
    result, events = run(node, clock=clock, bus=bus, stop_ns=35 * MS)
    assert result.tx_failures == 6
    assert [event.kind for event in events] == [EventKind.FRAME]
    assert "2 frames not sent" in events[0].text


def test_frames_lost_in_the_receive_queue_are_reported_with_their_number() -> None:
    clock = FakeClock()
    bus = FakeBus(clock)

    def work(now_ns: int) -> None:
        bus.rx_lost = 3 if now_ns >= 20 * MS else 0

    _, events = run(FakeNode(work), clock=clock, bus=bus)
    assert [event.kind for event in events] == [EventKind.FRAME]
    assert events[0].text == "3 frames lost in the kernel's receive queue so far"


def test_error_frames_are_reported_with_their_number_and_in_words() -> None:
    clock = FakeClock()
    bus = FakeBus(clock)

    def work(now_ns: int) -> None:
        bus.error_frames = 2 if now_ns >= 20 * MS else 0

    _, events = run(FakeNode(work), clock=clock, bus=bus)
    text = "2 error frames of the controller so far: nobody acknowledged, bus error"
    assert [event.text for event in events] == [text]


def test_node_whose_step_raises_ends_by_name_and_moves_nothing_more() -> None:
    clock, port = FakeClock(), FakePort()

    def work(now_ns: int) -> None:
        if now_ns == 30 * MS:
            raise ValueError("no such\n gain")

    node = FakeNode(work)
    bus = FakeBus(clock)
    result, events = run(node, clock=clock, bus=bus, port=port)
    assert len(node.steps) == 3 and len(port.actuated) == 2
    assert result.exit_code == 1
    assert result.failure is not None
    assert result.failure.startswith("ValueError: no such gain (test_runtime_node_process.py:")
    assert events[-1].node == "Steering" and "Steering ends: ValueError" in events[-1].text


def test_hardware_that_fails_ends_the_node() -> None:
    class BrokenPort(FakePort):
        def actuate(self, now_ns: int, actuator: Any) -> None:
            raise OSError(5, "Input/output error")

    clock = FakeClock()
    result, _ = run(FakeNode(), clock=clock, bus=FakeBus(clock), port=BrokenPort())
    assert result.exit_code == 1 and "Input/output error" in (result.failure or "")


def test_node_told_to_end_during_a_step_sends_nothing_late() -> None:
    clock, port = FakeClock(), FakePort()

    def work(now_ns: int) -> StepOutput[Any]:
        clock.now_ns += 500 * MS
        return StepOutput(frames=[Frame(0x182)], actuator="late", events=())

    bus = FakeBus(clock)
    result, _ = run(FakeNode(work), clock=clock, bus=bus, port=port)
    assert bus.sent == [] and port.actuated == [] and result.exit_code == 0


def test_a_step_without_a_command_leaves_the_hardware_to_its_watchdog() -> None:
    def starts(now_ns: int) -> StepOutput[Any] | None:
        is_starting = now_ns < 50 * MS
        return StepOutput(frames=(), actuator=None, events=()) if is_starting else None

    clock, port = FakeClock(), FakePort()
    run(FakeNode(starts), clock=clock, bus=FakeBus(clock), port=port)
    assert [now_ns for now_ns, _ in port.actuated] == [n * 10 * MS for n in range(5, 11)]
