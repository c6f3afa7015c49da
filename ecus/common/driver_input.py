"""Debounced detection of a driver who takes the controls."""

from __future__ import annotations


class Debounce:
    """True once a condition has held for `hold_ns` without a gap; false with the first gap."""

    __slots__ = ("_since_ns", "hold_ns")

    def __init__(self, hold_ns: int) -> None:
        self.hold_ns = hold_ns
        self._since_ns: int | None = None

    def update(self, condition: bool, now_ns: int) -> bool:
        """The debounced condition after this step's reading."""
        if not condition:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns >= self.hold_ns

    @property
    def since_ns(self) -> int | None:
        """When the condition last began, None while it does not hold."""
        return self._since_ns
