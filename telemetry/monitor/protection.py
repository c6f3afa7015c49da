"""Counter and CRC of one identifier's frames, judged as a receiver judges them."""

from __future__ import annotations

from typing import Final

from dbc.protection import (
    COUNTER_BYTE,
    COUNTER_MODULO,
    PROTECTED_LENGTH,
    UNKNOWN,
    AliveCheck,
    AliveState,
    is_intact,
)

STATE_TEXT: Final = {
    AliveState.INITIAL: "",
    AliveState.OK: "ok",
    AliveState.REPEATED: "repeated",
    AliveState.LOST_ONE: "one lost",
    AliveState.WRONG_SEQUENCE: "out of sequence",
    AliveState.ERROR: "CRC wrong",
}
FIRST_TEXT: Final = "first"
"""The frame that only tells where the counter stands: nobody's fault."""


class Protection:
    """What a receiver of one identifier would say of its frames.

    Attributes:
        state: Of the newest frame.
        counter: Of the newest frame; None if its CRC or length was wrong.
        is_first: Whether the newest frame is the first with a counter.
        faults: Frames that were not as they should be, the first one apart.
    """

    __slots__ = ("_check", "_data_id", "counter", "faults", "is_first")

    def __init__(self, data_id: int) -> None:
        self._data_id = data_id
        self._check = AliveCheck()
        self.counter: int | None = None
        self.is_first = False
        self.faults = 0

    @property
    def state(self) -> AliveState:
        """Of the newest frame."""
        return self._check.state

    def take(self, data: bytes) -> None:
        """Judges the next frame."""
        check = self._check
        if len(data) == PROTECTED_LENGTH and is_intact(data, self._data_id):
            counter = self.counter = data[COUNTER_BYTE] & 0x0F
            if check.is_in_sequence and counter == check.expected:  # as a rule
                check.expected = (counter + 1) % COUNTER_MODULO
                check.state = AliveState.OK
                return
            self.is_first = check.expected == UNKNOWN
        else:
            self.counter, self.is_first = None, False
        state = check.judge(self.counter)
        self.faults += state is not AliveState.OK and not self.is_first

    def text(self) -> str:
        """Counter and verdict: `7 ok`."""
        if self.is_first and self.state is AliveState.WRONG_SEQUENCE:
            return f"{self.counter} {FIRST_TEXT}"
        verdict = STATE_TEXT[self.state]
        return verdict if self.counter is None else f"{self.counter} {verdict}"
