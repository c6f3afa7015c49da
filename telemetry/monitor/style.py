"""Styled text: spans, and the terminal's colours for them."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Final, NamedTuple


class Style(Enum):
    """How text is to look; the value is the terminal's code (ECMA-48, SGR)."""

    PLAIN = ""
    DIM = "2"
    BOLD = "1"
    MESSAGE = "36"
    GOOD = "32"
    WARN = "33"
    BAD = "1;31"
    CHANGED = "1;33"
    TITLE = "7"
    CHOSEN = "7;36"


PLAIN: Final = Style.PLAIN
DIM: Final = Style.DIM
BOLD: Final = Style.BOLD
MESSAGE: Final = Style.MESSAGE
GOOD: Final = Style.GOOD
WARN: Final = Style.WARN
BAD: Final = Style.BAD
CHANGED: Final = Style.CHANGED
TITLE: Final = Style.TITLE
CHOSEN: Final = Style.CHOSEN

_CODE: Final = {style: f"\x1b[{style.value}m" for style in Style}
_RESET: Final = "\x1b[0m"


class Span(NamedTuple):
    """Text of one style."""

    text: str
    style: Style


def plain_text(spans: Iterable[Span]) -> str:
    """The text alone."""
    return "".join([span.text for span in spans])


def coloured(spans: Iterable[Span]) -> str:
    """The text with the terminal's codes."""
    return "".join(
        [text if style is PLAIN else f"{_CODE[style]}{text}{_RESET}" for text, style in spans]
    )


def printable(text: str) -> str:
    """Text of unknown origin without anything that a terminal obeys."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def fitted(spans: Iterable[Span], width: int) -> list[Span]:
    """The line cut to a terminal's width."""
    line: list[Span] = []
    left = width
    for span in spans:
        if len(span.text) >= left:
            line.append(Span(span.text[:left], span.style))
            break
        line.append(span)
        left -= len(span.text)
    return line
