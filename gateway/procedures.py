"""What takes time, written once for blocking and async callers.

Each procedure is a generator of the times until which its caller must wait; between them it looks
at the car and asks again. Closing it early takes back what it asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Generator

from canbus.node import PERIOD_NS
from dbc.messages import Mode, Request
from gateway.core import PlannerInputs
from gateway.errors import DisengageFailed, EngageRefused, ResetRefused
from gateway.link import Link
from gateway.requests import REQUEST_PERIOD_NS

POLL_NS = PERIOD_NS
"""The state changes no more often than this."""

WITHDRAWN_NS = 4 * REQUEST_PERIOD_NS
"""A request withdrawn may still be granted for so long: even with every frame that tells of it
lost, the supervisor takes one that is no longer repeated for withdrawn by then."""

WITHDRAW = PlannerInputs(request=Request.NONE)


def engage(link: Link, timeout_ns: int) -> Generator[int, None, None]:
    """Asks for AUTOMATIC until it is there.

    Raises:
        EngageRefused: It was not in time. The request is withdrawn, and the supervisor has had
            time to hear of that: the car will not start later by itself.
    """
    deadline_ns = link.now_ns() + timeout_ns
    try:
        yield from _ask(link, Request.ENGAGE, deadline_ns, lambda: link.state().is_engaged)
        if link.state().is_engaged:
            return
        link.submit(WITHDRAW)
        yield deadline_ns + WITHDRAWN_NS
        state = link.state()
        if not state.is_engaged:
            raise EngageRefused(state.why_not_engaged)
    except GeneratorExit:
        link.submit(WITHDRAW)
        raise


def disengage(link: Link, timeout_ns: int) -> Generator[int, None, None]:
    """Asks the supervisor to stop driving, and waits for READY or MANUAL.

    Raises:
        DisengageFailed: An emergency brake came first, or the time is over. The request goes on.
    """
    deadline_ns = link.now_ns() + timeout_ns
    link.submit(PlannerInputs(request=Request.DISENGAGE))
    while True:
        state = link.state()
        if state.mode is Mode.EMERGENCY:
            raise DisengageFailed(state.why_not_engaged)
        # While the request is pending the mode is not yet the supervisor's answer.
        is_answered = state.pending_request is not Request.DISENGAGE
        if is_answered and state.mode in (Mode.READY, Mode.MANUAL):
            return
        now_ns = link.now_ns()
        if now_ns >= deadline_ns:
            mode = "unknown" if state.mode is None else state.mode.name
            why = f": {state.why_not_engaged}" if state.why_not_engaged else ""
            raise DisengageFailed(f"mode {mode} after {timeout_ns / 1e9:g} s{why}")
        yield min(now_ns + POLL_NS, deadline_ns)


def reset(link: Link, timeout_ns: int) -> Generator[int, None, None]:
    """Asks for a reset until the supervisor has raised the reset epoch.

    Raises:
        ResetRefused: It did not in time; the text is the reason why the car is not engaged.
    """
    deadline_ns = link.now_ns() + timeout_ns
    epochs: set[int] = set()

    def is_reset() -> bool:
        epoch = link.state().reset_epoch
        if epoch is not None:
            epochs.add(epoch)
        return len(epochs) > 1

    is_reset()
    try:
        yield from _ask(link, Request.RESET, deadline_ns, is_reset)
    except GeneratorExit:
        link.submit(WITHDRAW)
        raise
    if not is_reset():
        link.submit(WITHDRAW)
        raise ResetRefused(link.state().why_not_engaged or "the car is engaged: disengage() first")


def _ask(
    link: Link, request: Request, deadline_ns: int, is_done: Callable[[], bool]
) -> Generator[int, None, None]:
    """Repeats a request, which lapses by itself, until done or the deadline."""
    is_asked = False
    while not is_done():
        now_ns = link.now_ns()
        if now_ns >= deadline_ns:
            return
        if not is_asked or link.state().pending_request is Request.NONE:
            link.submit(PlannerInputs(request=request))
            is_asked = True
        yield min(now_ns + POLL_NS, deadline_ns)
