"""A node's own clock: it starts somewhere and drifts, so that mixing clocks fails loudly."""

from __future__ import annotations

from typing import Final

from canbus.frame import Frame, ReceivedFrame

PPM: Final = 1_000_000


class NodeClock:
    """Local time = epoch + true time x (1 + drift). Integer arithmetic, exactly repeatable.

    Times are split at whole multiples, so that products stay small: those of factors that are
    negative or beyond 2**30 take several times as long.
    """

    __slots__ = ("drift_ppm", "epoch_ns")

    def __init__(self, epoch_ns: int, drift_ppm: int) -> None:
        assert abs(drift_ppm) < PPM // 100, "a crystal is better than one per cent"
        self.epoch_ns = epoch_ns
        self.drift_ppm = drift_ppm

    def jump(self, span_ns: int) -> None:
        """The clock shows `span_ns` more from now on."""
        self.epoch_ns += span_ns

    def drift(self, true_ns: int, drift_ppm: int) -> None:
        """From this true time on it runs with another drift, without a jump."""
        shown_ns = self.local_ns(true_ns)
        assert abs(drift_ppm) < PPM // 100, "a crystal is better than one per cent"
        self.drift_ppm = drift_ppm
        self.epoch_ns += shown_ns - self.local_ns(true_ns)

    def local_ns(self, true_ns: int) -> int:
        """The node's time at a true time."""
        pace = PPM + self.drift_ppm
        return self.epoch_ns + true_ns // PPM * pace + true_ns % PPM * pace // PPM

    def received(self, heard: list[tuple[int, Frame]]) -> list[ReceivedFrame]:
        """Frames with true times as the node sees them: with its own times."""
        if not heard:
            return []
        begin_ns, pace = heard[0][0] // PPM * PPM, PPM + self.drift_ppm
        shown_ns = self.local_ns(begin_ns)
        return [
            ReceivedFrame(shown_ns + (true_ns - begin_ns) * pace // PPM, frame)
            for true_ns, frame in heard
        ]

    def true_ns(self, local_ns: int) -> int:
        """The first true time at which the node's clock shows at least `local_ns`."""
        elapsed_ns, pace = local_ns - self.epoch_ns, PPM + self.drift_ppm
        return elapsed_ns // pace * PPM + (elapsed_ns % pace * PPM + pace - 1) // pace
