"""The error codes of the gateway itself: an EMCY when one comes, and one when all are gone."""

from __future__ import annotations

from typing import Final

from canbus.canopen_node import CanopenNode
from dbc.messages import ErrorCode, Reason

REPORT_NS: Final = 1_000_000_000
"""A code is reported for this long after its cause was last seen."""

EMCY_CODE_BASE: Final = 0xFF00
"""CiA 301: device-specific emergency error codes."""
EMCY_REGISTER: Final = 0x81
"""CiA 301 object 0x1001: generic error and manufacturer-specific error."""


class CodeReport:
    """Codes seen within the last second. The gateway drives nothing, so it latches nothing."""

    def __init__(self, canopen: CanopenNode) -> None:
        self._canopen = canopen
        self._seen_ns: dict[ErrorCode, int] = {}

    def add(self, code: ErrorCode, reason: Reason, now_ns: int) -> bool:
        """Notes a cause; True when the code is new, and so worth a line in the log."""
        is_new = code not in self._seen_ns
        self._seen_ns[code] = now_ns
        if is_new:
            bits = sum(1 << seen for seen in self._seen_ns)
            payload = bytes([code, reason, bits, 0, 0])
            self._canopen.emergency(now_ns, EMCY_CODE_BASE + code, EMCY_REGISTER, payload)
        return is_new

    def expire(self, now_ns: int) -> None:
        """Drops what was last seen too long ago; says so when nothing is left (error reset)."""
        if not self._seen_ns:
            return
        old = [code for code, seen_ns in self._seen_ns.items() if now_ns - seen_ns > REPORT_NS]
        for code in old:
            del self._seen_ns[code]
        if old and not self._seen_ns:
            self._canopen.emergency(now_ns, 0, 0, bytes([ErrorCode.NONE, 0, 0, 0, 0]))
