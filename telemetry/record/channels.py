"""Numbers for channels, in formats that have no names for them."""

from __future__ import annotations

from typing import Final

NUMBER_MAX: Final = 254
"""What fits the one byte of MF4 and BLF, counted from 1 as well as from 0."""


class ChannelNumbers:
    """Gives each name a number: a name that is a number its own, the others what is free."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def number(self, name: str) -> int:
        """The number of a channel, from 0; beyond the 255th all share the last."""
        found = self._numbers.get(name)
        return self._new(name) if found is None else found

    def renamed(self) -> list[str]:
        """Which names are lost, as `vcan0 is 0`."""
        return [f"{name} is {number}" for name, number in self._numbers.items()
                if name != str(number)]  # fmt: skip

    def _new(self, name: str) -> int:
        taken = set(self._numbers.values())
        number = int(name) if name.isascii() and name.isdecimal() and len(name) < 4 else 0
        if str(number) != name or number in taken or number > NUMBER_MAX:
            number = next((n for n in range(NUMBER_MAX) if n not in taken), NUMBER_MAX)
        self._numbers[name] = number
        return number
