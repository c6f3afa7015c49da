"""What of a log could not be read: where, why and how often. Nothing is dropped silently."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

PLACES_TOLD: Final = 3
EXAMPLE_CHARACTERS: Final = 50


@dataclass(slots=True)
class _Kind:
    count: int = 0
    places: list[str] = field(default_factory=list)


class Problems:
    """Gathers complaints about one log.

    Args:
        unit: What places are counted in: `line`, or `frame` for binary logs.
    """

    def __init__(self, unit: str = "line") -> None:
        self.unit = unit
        self._kinds: dict[str, _Kind] = {}
        self._remarks: list[str] = []

    @property
    def count(self) -> int:
        """How many lines or frames were not read."""
        return sum(kind.count for kind in self._kinds.values())

    def add(self, place: int, reason: str, example: str = "") -> None:
        """One line or frame was not read."""
        kind = self._kinds.setdefault(reason, _Kind())
        kind.count += 1
        if len(kind.places) < PLACES_TOLD:
            text = example.strip()
            if len(text) > EXAMPLE_CHARACTERS:
                text = text[: EXAMPLE_CHARACTERS - 3] + "..."
            kind.places.append(f"{self.unit} {place}" + (f" {text!r}" if text else ""))

    def remark(self, text: str) -> None:
        """Something about the log as a whole."""
        if text not in self._remarks:
            self._remarks.append(text)

    def lines(self) -> list[str]:
        """All of it in words, a line for each kind."""
        told = []
        for reason, kind in self._kinds.items():
            places = ", ".join(kind.places)
            if kind.count > len(kind.places):
                places += f" and {kind.count - len(kind.places)} more"
            plural = self.unit + "s" * (kind.count != 1)
            told.append(f"{kind.count} {plural} not read: {reason}: {places}")
        return told + self._remarks
