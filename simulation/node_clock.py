"""A node's own clock: it starts somewhere and drifts, so that mixing clocks fails loudly."""

from __future__ import annotations

from typing import Final

from canbus.frame import Frame, ReceivedFrame

PPM: Final = 1_000_000


class NodeClock:
    """Local time = epoch + true time x (1 + drift). Integer arithmetic, exactly repeatable.

    Products are kept small: beyond 2**30 they take several times as long. The result is the same.
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
        drift_ppm = self.drift_ppm
        drifted_ns = true_ns // PPM * drift_ppm + true_ns % PPM * drift_ppm // PPM
        return self.epoch_ns + true_ns + drifted_ns

    def received(self, heard: list[tuple[int, Frame]]) -> list[ReceivedFrame]:
        """Frames with true times as the node sees them: with its own times."""
        if not heard:
            return []
        first_ns, ppm = heard[0][0], self.drift_ppm
        drift = first_ns * ppm
        base_ns, rest = self.epoch_ns + drift // PPM, drift % PPM
        return [
            ReceivedFrame(base_ns + true_ns + (rest + (true_ns - first_ns) * ppm) // PPM, frame)
            for true_ns, frame in heard
        ]

    def true_ns(self, local_ns: int) -> int:
        """The first true time at which the node's clock shows at least `local_ns`."""
        elapsed_ns = local_ns - self.epoch_ns
        guess_ns = elapsed_ns * PPM // (PPM + self.drift_ppm)
        while self.local_ns(guess_ns) < local_ns:
            guess_ns += 1
        return guess_ns
