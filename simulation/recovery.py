"""The way back from bus-off: 128 times eleven recessive bits in a row (ISO 11898-1)."""

from __future__ import annotations

from collections.abc import Callable

from canbus.timing import bits_time_ns
from simulation.controller import RECOVERY_BITS, RECOVERY_SEQUENCES, Controller
from simulation.kernel import Kernel

PRIORITY = 0


class Recovery:
    """Counts for one controller while others use the bus, or nobody does.

    Args:
        kernel: plans the end of an idle wait.
        bitrate_bps: of the bus.
        controller: who waits.
        is_back: told when the last sequence has been counted, with the true time.
    """

    def __init__(
        self,
        kernel: Kernel,
        bitrate_bps: int,
        controller: Controller,
        is_back: Callable[[int, Recovery], None],
    ) -> None:
        self.controller = controller
        self._kernel = kernel
        self._sequence_ns = bits_time_ns(RECOVERY_BITS, bitrate_bps)
        self._left = RECOVERY_SEQUENCES
        self._idle_since_ns = 0
        self._plan = 0
        self._is_back = is_back

    def idle_from(self, true_ns: int) -> None:
        """Nobody sends from now on."""
        self._idle_since_ns = true_ns
        self._plan += 1
        plan = self._plan
        end_ns = true_ns + max(self._left, 0) * self._sequence_ns
        self._kernel.at(end_ns, PRIORITY, lambda now_ns: self._end(now_ns, plan))

    def begins(self, true_ns: int) -> None:
        """A frame begins: what was idle until now counts."""
        self._plan += 1
        self._left -= max(true_ns - self._idle_since_ns, 0) // self._sequence_ns

    def ends(self, free_ns: int) -> None:
        """A frame or an error frame has ended: its own end is one sequence."""
        self._left -= 1
        self.idle_from(free_ns)

    def _end(self, now_ns: int, plan: int) -> None:
        if plan == self._plan:
            self._is_back(now_ns, self)
