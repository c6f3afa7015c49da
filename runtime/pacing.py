"""Cyclic work at absolute deadlines.

The deadlines lie on a fixed grid, so a late cycle does not shift the ones after it. Missed
deadlines are skipped and counted, never caught up: a burst of frames would look like a second
sender, and commands worked out from old readings help nobody.

After openpilot's `Ratekeeper` (https://github.com/commaai/openpilot, common/realtime.py), which
paces by absolute times and counts the lag; unlike it, this one neither sleeps nor reads a clock.
"""

from __future__ import annotations

from canbus.node import PERIOD_NS

GAP_NS_MIN = 2_000_000
"""Shortest time from the end of a cycle to the begin of the next."""

# A wider gap would skip a cycle for every lag that is worth no word; a skipped cycle is an overrun
# to the node (`canbus.cycle`). A rate above the DBC's is no danger: the grid bounds the mean.
assert GAP_NS_MIN < PERIOD_NS // 2


class Pacer:
    """Tells when the next cycle is due and keeps count of how well that went.

    Args:
        start_ns: time now; the first deadline is after it.
        period_ns: distance of the deadlines.
        phase_ns: where they lie within the period; 0 <= phase_ns < period_ns.
        gap_ns_min: shortest time from the end of a cycle to the next deadline; a nearer deadline
            is skipped.

    Attributes:
        next_deadline_ns: when the next cycle is due.
        cycles: cycles begun.
        overruns: cycles that were not over when the next one was due.
        skipped: deadlines left out.
        lag_ns: how late the latest cycle began.
        lag_ns_max: the worst of them.
    """

    __slots__ = (
        "_gap_ns_min",
        "_period_ns",
        "cycles",
        "lag_ns",
        "lag_ns_max",
        "next_deadline_ns",
        "overruns",
        "skipped",
    )

    def __init__(
        self,
        *,
        start_ns: int,
        period_ns: int = PERIOD_NS,
        phase_ns: int = 0,
        gap_ns_min: int = GAP_NS_MIN,
    ) -> None:
        assert period_ns > 0 and 0 <= phase_ns < period_ns, f"{phase_ns} of {period_ns} ns"
        assert 0 <= gap_ns_min < period_ns, f"{gap_ns_min} of {period_ns} ns"
        self._period_ns = period_ns
        self._gap_ns_min = gap_ns_min
        periods = (start_ns - phase_ns) // period_ns + 1
        self.next_deadline_ns = periods * period_ns + phase_ns
        self.cycles = 0
        self.overruns = 0
        self.skipped = 0
        self.lag_ns = 0
        self.lag_ns_max = 0

    def wait_ns(self, now_ns: int) -> int:
        """Time until the next cycle is due; 0 when it is."""
        return max(0, self.next_deadline_ns - now_ns)

    def begin(self, now_ns: int) -> int:
        """A cycle begins. Answers how late it is, in ns."""
        assert now_ns >= self.next_deadline_ns, "the cycle is not due yet"
        self.cycles += 1
        self.lag_ns = now_ns - self.next_deadline_ns
        self.lag_ns_max = max(self.lag_ns_max, self.lag_ns)
        return self.lag_ns

    def end(self, now_ns: int) -> bool:
        """The cycle is over; the next deadline is set. Answers whether it overran."""
        self.next_deadline_ns += self._period_ns
        overran = now_ns >= self.next_deadline_ns
        self.overruns += overran
        missing_ns = now_ns + self._gap_ns_min - self.next_deadline_ns
        if missing_ns > 0:
            periods = -(-missing_ns // self._period_ns)
            self.skipped += periods
            self.next_deadline_ns += periods * self._period_ns
        return overran
