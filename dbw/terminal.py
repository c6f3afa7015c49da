"""A terminal taken over and given back, whatever happens in between."""

from __future__ import annotations

import os
import select
import signal
import termios
import tty
from collections.abc import Callable
from types import FrameType
from typing import Any, Final, Self

from telemetry.monitor.style import Span, coloured, plain_text

ENTER: Final = "\x1b[?1049h\x1b[?25l\x1b[?7l\x1b[2J"
"""Alternate screen, no cursor, no wrapping of long lines, empty."""
LEAVE: Final = "\x1b[?7h\x1b[?25h\x1b[?1049l"
CLEAR: Final = "\x1b[2J"
KEY_BYTES: Final = 256

_SPECIAL: Final = {
    "\x1b[A": "up", "\x1b[B": "down", "\x1bOA": "up", "\x1bOB": "down", "\x1b[5~": "pgup",
    "\x1b[6~": "pgdn", "\x1b[H": "home", "\x1b[F": "end", "\x1bOH": "home", "\x1bOF": "end",
    "\x1b[1~": "home", "\x1b[4~": "end",
}  # fmt: skip
_NAMED: Final = {"\r": "enter", "\n": "enter", "\x7f": "backspace", "\x08": "backspace"}


class Terminal:
    """Raw keys in, lines out; only lines that changed are written. Used with `with`.

    Leaving the block gives the terminal back as it was, whether it ends, raises or is interrupted.
    Ctrl-C stays an interrupt. When the process is stopped (Ctrl-Z) the terminal is given back for
    as long, too.

    Args:
        keyboard: File descriptor of the terminal to read keys from.
        screen: File descriptor of the terminal to write to.
        with_colours: Whether to use colours.
    """

    def __init__(self, keyboard: int, screen: int, *, with_colours: bool) -> None:
        self._keyboard = keyboard
        self._screen = screen
        self._text: Callable[[list[Span]], str] = coloured if with_colours else plain_text
        self._shown: list[str] = []
        self._size = (0, 0)
        self._saved: list[Any] = []
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Self:
        """Takes the terminal."""
        self._saved = termios.tcgetattr(self._keyboard)
        try:
            self._take()
            self._handlers = {signal.SIGTSTP: signal.signal(signal.SIGTSTP, self._stop)}
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        """Gives it back."""
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._give_back()

    def keys(self, timeout_s: float) -> list[str]:
        """Keys pressed within a time: characters, and names of special keys.

        Raises:
            EOFError: The terminal is gone.
        """
        if not select.select([self._keyboard], [], [], timeout_s)[0]:
            return []
        data = os.read(self._keyboard, KEY_BYTES)
        if not data:
            raise EOFError
        return parse_keys(data.decode("utf-8", errors="replace"))

    def size(self) -> tuple[int, int]:
        """Width and height in cells; asked each time, so that a new size needs no signal."""
        size = os.get_terminal_size(self._screen)
        return size.columns, size.lines

    def draw(self, lines: list[list[Span]]) -> None:
        """Shows lines from the top; as many as the screen is high, none longer than it is wide."""
        size = self.size()
        out = []
        if size != self._size:
            self._size, self._shown = size, []
            out.append(CLEAR)
        texts = [self._text(line) for line in lines]
        for number, text in enumerate(texts):
            if number >= len(self._shown) or self._shown[number] != text:
                out.append(f"\x1b[{number + 1};1H{text}\x1b[K")
        self._shown = texts
        if out:
            self._write("".join(out))

    def _take(self) -> None:
        tty.setcbreak(self._keyboard)
        self._shown, self._size = [], (0, 0)
        self._write(ENTER)

    def _give_back(self) -> None:
        termios.tcsetattr(self._keyboard, termios.TCSADRAIN, self._saved)
        self._write(LEAVE)

    def _write(self, text: str) -> None:
        data = text.encode()
        while data:
            data = data[os.write(self._screen, data) :]

    def _stop(self, number: int, frame: FrameType | None) -> None:
        """Ctrl-Z: gives the terminal back, stops, and takes it again when it goes on."""
        self._give_back()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._take()


def parse_keys(text: str) -> list[str]:
    """What was typed, as keys; unknown escape sequences are left out."""
    keys = []
    while text:
        special = next((code for code in _SPECIAL if text.startswith(code)), None)
        if special is not None:
            keys.append(_SPECIAL[special])
            text = text[len(special) :]
        elif text[0] == "\x1b":
            rest = text[1:]
            if rest[:1] in ("[", "O"):
                end = next((n for n, c in enumerate(rest[1:], 1) if c.isalpha() or c == "~"), None)
                text = "" if end is None else rest[end + 1 :]
            else:
                keys.append("esc")
                text = rest
        else:
            keys.append(_NAMED.get(text[0], text[0]))
            text = text[1:]
    return keys
