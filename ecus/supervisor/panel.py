"""Button and mode requests: what somebody asked for, each asking counted once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from dbc.endpoint import SPEC_OF_NAME, Message
from dbc.messages import HeartbeatState, ModeRequest, Request
from ecus.common.driver_input import Debounce

BUTTON_DEBOUNCE_NS: Final = 30_000_000
REQUEST_PENDING_NS: Final = 60_000_000
"""A request is pending while its frames (every 20 ms) keep coming; two may be lost."""

_REQUEST_ID: Final = SPEC_OF_NAME["MODE_REQUEST"].can_id
_HEARTBEAT_ID: Final = SPEC_OF_NAME["GATEWAY_HEARTBEAT"].can_id


class Button:
    """A debounced push button: `pushed` once per push."""

    def __init__(self) -> None:
        self._debounce = Debounce(BUTTON_DEBOUNCE_NS)
        self._is_down = True
        """A button held since power-on is not a push."""

    def pushed(self, is_pressed: bool, now_ns: int) -> bool:
        """True in the step in which a push is recognised."""
        was_down = self._is_down
        self._is_down = self._debounce.update(is_pressed, now_ns) or (was_down and is_pressed)
        return self._is_down and not was_down


class Requests:
    """The gateway's request: pending until it has been granted, withdrawn or replaced."""

    def __init__(self) -> None:
        self._request: ModeRequest | None = None
        self._heard_ns = 0
        self._done_sequence: int | None = None

    def take(self, messages: Sequence[Message]) -> ModeRequest | None:
        """Takes in this step's MODE_REQUEST frames; answers the newest of them."""
        newest = None
        for message in messages:
            if message.can_id == _HEARTBEAT_ID and message.content.state is HeartbeatState.BOOT_UP:
                self._request = self._done_sequence = None  # a restarted gateway counts anew
            if message.can_id == _REQUEST_ID:
                newest = self._request = message.content
                self._heard_ns = message.arrival_ns
        return newest

    def pending(self, now_ns: int) -> Request:
        """What is asked for and not done yet."""
        request = self._request
        if request is None or now_ns - self._heard_ns > REQUEST_PENDING_NS:
            return Request.NONE
        if request.sequence == self._done_sequence:
            return Request.NONE
        return request.request

    def done(self) -> None:
        """The pending request was granted: its repetitions ask for nothing more."""
        if self._request is not None:
            self._done_sequence = self._request.sequence
