"""The error codes ER0 to ER6 of one node: present, reported, latched (UWA Table 2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

from dbc.messages import ErrorCode, Reason

ER_CODES: Final = 7
NO_CODES: Final[frozenset[ErrorCode]] = frozenset()

REPORT_NS: Final = 1_000_000_000
"""A code that is not latched stays reported this long after its cause was last seen."""

EMCY_CODE_BASE: Final = 0xFF00
"""CiA 301: device-specific emergency error codes."""
EMCY_REGISTER_GENERIC: Final = 0x81
"""CiA 301 object 0x1001: generic error and manufacturer-specific error."""


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Cause:
    """One reason for a code, seen in this step. `seen_ns` is when it began, on the node's clock."""

    code: Final[ErrorCode]
    reason: Final[Reason]
    seen_ns: Final[int]

    def __init__(self, *, code: ErrorCode, reason: Reason, seen_ns: int) -> None:
        self.code = code
        self.reason = reason
        self.seen_ns = seen_ns


class CodeLatch:
    """Which codes a node reports.

    A code raised while the node drives (or is in its safe state) is latched until the supervisor
    raises the reset epoch; raised under a human driver it is reported while it is there.
    """

    __slots__ = ("_latched", "_seen_ns")

    def __init__(self) -> None:
        self._latched: set[ErrorCode] = set()
        self._seen_ns: dict[ErrorCode, int] = {}

    def raise_code(self, code: ErrorCode, now_ns: int, *, latch: bool) -> bool:
        """Notes a code; True when it was not reported before, so an EMCY is due."""
        is_new = not self.is_reported(code, now_ns)
        self._seen_ns[code] = now_ns
        if latch:
            self._latched.add(code)
        return is_new

    def is_reported(self, code: ErrorCode, now_ns: int) -> bool:
        """Latched, or seen within the last second."""
        seen_ns = self._seen_ns.get(code)
        return code in self._latched or (seen_ns is not None and now_ns - seen_ns <= REPORT_NS)

    def reported(self, now_ns: int) -> frozenset[ErrorCode]:
        """All codes reported now."""
        if not self._seen_ns:
            return NO_CODES
        return frozenset(code for code in self._seen_ns if self.is_reported(code, now_ns))

    def present(self, now_ns: int) -> frozenset[ErrorCode]:
        """Codes whose cause was seen in this very step."""
        if not self._seen_ns:
            return NO_CODES
        return frozenset(code for code, seen_ns in self._seen_ns.items() if seen_ns == now_ns)

    def reset(self) -> None:
        """Unlatches: a cause that is still there raises its code again in the same step."""
        self._latched.clear()
        self._seen_ns.clear()


@cache
def code_bits(codes: frozenset[ErrorCode]) -> int:
    """Bit n set for ERn."""
    return sum(1 << code for code in codes)


@cache
def code_flags(codes: frozenset[ErrorCode]) -> tuple[bool, ...]:
    """The signals er0 to er6 of a status message."""
    return tuple(ErrorCode(n) in codes for n in range(ER_CODES))


def emcy_payload(cause: Cause, codes: frozenset[ErrorCode]) -> bytes:
    """The five manufacturer bytes of an EMCY, as the DBC lays them out."""
    return bytes([cause.code, cause.reason, code_bits(codes), 0, 0])
