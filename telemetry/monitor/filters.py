"""candump's filters: `vcan0,123:7FF,200~700,#FFFFFFFF,j` is a channel and what to show of it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Self

from canbus.heard import ERROR_CLASSES_ALL, ERROR_FLAG, EXTENDED_FLAG

_FILTER: Final = re.compile(r"([0-9A-Fa-f]{1,8})([:~])([0-9A-Fa-f]{1,8})")
_ERRORS: Final = re.compile(r"#([0-9A-Fa-f]{1,8})")
_LONG_ID: Final = 8
"""An identifier with eight digits is one of 29 bits."""
ALLOWED: Final = (
    "allowed ID:MASK, ID~MASK (all others), #ERRORMASK and j (all filters at once), in hexadecimal"
)


class FilterError(ValueError):
    """A filter that cannot be understood; one line that says what is allowed."""


@dataclass(frozen=True, slots=True)
class IdFilter:
    """Frames whose identifier, with its flags, equals `wanted` where `mask` has ones."""

    wanted: int
    mask: int
    is_inverse: bool

    def passes(self, word: int) -> bool:
        """As the kernel decides (linux/can.h, `struct can_filter`)."""
        return ((word ^ self.wanted) & self.mask == 0) is not self.is_inverse


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """A channel, and which of its frames are wanted.

    Attributes:
        channel: Name of the interface.
        filters: One must pass a frame, or all if `is_joined`; without any, every frame passes.
        is_joined: Whether all filters must pass it.
        error_classes: Classes of error frames that are wanted. candump wants none unless asked.
    """

    channel: str
    filters: tuple[IdFilter, ...] = ()
    is_joined: bool = False
    error_classes: int = ERROR_CLASSES_ALL

    @classmethod
    def parse(cls, text: str) -> Self:
        """A source as candump's command line has it.

        Raises:
            FilterError: It is none; the part that is wrong is named.
        """
        channel, *parts = text.split(",")
        if not channel or not channel.isprintable() or " " in channel:
            raise FilterError(f"{text!r}: the name of a channel is wanted first")
        filters, is_joined, error_classes = [], False, ERROR_CLASSES_ALL
        for part in parts:
            if found := _FILTER.fullmatch(part):
                filters.append(_id_filter(*found.groups()))
            elif found := _ERRORS.fullmatch(part):
                error_classes = int(found[1], 16) & ERROR_CLASSES_ALL
            elif part in ("j", "J"):
                is_joined = True
            else:
                raise FilterError(f"filter {part!r} of {text!r}: {ALLOWED}")
        return cls(
            channel=channel,
            filters=tuple(filters),
            is_joined=is_joined,
            error_classes=error_classes,
        )

    def passes(self, word: int) -> bool:
        """Whether a frame of this channel is wanted."""
        if word & ERROR_FLAG:
            return bool(word & self.error_classes)
        if not self.filters:
            return True
        passed = (one.passes(word) for one in self.filters)
        return all(passed) if self.is_joined else any(passed)


def _id_filter(number: str, sign: str, mask: str) -> IdFilter:
    wanted = int(number, 16)
    if len(number) == _LONG_ID:
        wanted |= EXTENDED_FLAG
    return IdFilter(wanted, int(mask, 16) & ~ERROR_FLAG, sign == "~")
