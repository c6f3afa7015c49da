"""`dbw monitor --live`: the loop between bus, keys and screen."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Final

from canbus.heard import Heard
from canbus.listener import Listener
from dbw.failures import EXIT_OK
from dbw.terminal import Terminal
from runtime.clock import NS_PER_S
from telemetry.monitor.meaning import Interpreter
from telemetry.monitor.model import BusModel
from telemetry.monitor.screen import Screen
from telemetry.monitor.selection import Selection
from telemetry.monitor.view import View

READ_NS: Final = 20_000_000
"""How often the bus is read: often enough for keys, seldom enough to read many frames at once. The
kernel keeps 180 frames of a full 1 Mbit/s bus for as long; a queue holds 270 as a rule."""
DRAW_NS: Final = 200_000_000
"""How often the screen is drawn; a key draws at once."""


class LiveMonitor:
    """Reads, listens to keys and draws, until a key ends it.

    Args:
        listener: Open.
        terminal: Open.
        interpreter: Finds the meaning of frames.
        selection: What to show.
        channels: Names of the channels.
        bitrate_bps: Of the bus.
        clock: Monotonic time in ns.
        realtime: The system's clock in ns since 1970.
    """

    def __init__(
        self,
        *,
        listener: Listener,
        terminal: Terminal,
        interpreter: Interpreter,
        selection: Selection,
        channels: list[str],
        bitrate_bps: int,
        clock: Callable[[], int],
        realtime: Callable[[], int],
    ) -> None:
        self._listener = listener
        self._terminal = terminal
        self._clock = clock
        self._realtime = realtime
        self._model = BusModel(interpreter, channels)
        self._view = View(selection)
        self._screen = Screen(self._model, self._view, bitrate_bps)
        self._draw_ns = 0
        self._note = ""

    @property
    def frames(self) -> int:
        """Frames heard so far."""
        return sum(channel.frames for channel in self._model.channels.values())

    def run(self) -> None:
        """Until the end is asked for, or the terminal is gone."""
        try:
            while not self._view.is_ended:
                self.step()
        except EOFError:
            return

    def step(self) -> None:
        """Waits for keys for a moment, reads what has come meanwhile, and draws if it is time."""
        keys = self._terminal.keys(READ_NS / NS_PER_S)
        heard: list[Heard] = self._listener.hear(0)
        now_ns = self._clock()
        self._model.feed(heard, now_ns - self._realtime())
        for key in keys:
            self._view.press(key, self._model, now_ns)
        if keys or now_ns >= self._draw_ns:
            self._draw_ns = now_ns + DRAW_NS
            width, height = self._terminal.size()
            self._note = next(iter(self._listener.notes()[-1:]), self._note)
            lines = self._screen.lines(
                width, height, now_ns, lost=self._listener.lost, note=self._note
            )
            self._terminal.draw(lines)


def run_screen(
    *,
    listener: Listener,
    interpreter: Interpreter,
    selection: Selection,
    channels: list[str],
    bitrate_bps: int,
    with_colours: bool,
) -> int:
    """Shows the bus until `q` or Ctrl-C; the terminal is then as it was.

    Raises:
        BusError: A channel cannot be opened; nothing was shown then.
    """
    import sys

    from runtime.clock import monotonic_ns, realtime_ns

    gc.freeze()  # what is loaded stays: collections look at what comes and goes alone
    with (
        listener,
        Terminal(sys.stdin.fileno(), sys.stdout.fileno(), with_colours=with_colours) as terminal,
    ):
        LiveMonitor(
            listener=listener,
            terminal=terminal,
            interpreter=interpreter,
            selection=selection,
            channels=channels,
            bitrate_bps=bitrate_bps,
            clock=monotonic_ns,
            realtime=realtime_ns,
        ).run()
    return EXIT_OK
