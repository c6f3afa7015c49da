"""Signals anywhere in eight bytes, of either byte order, as a DBC may have them."""

from __future__ import annotations

from cantools.database.can import Signal
from hypothesis import strategies as st


@st.composite
def drawn_signals(draw: st.DrawFn) -> Signal:
    """One called `s`, of 1 to 64 bits."""
    length = draw(st.integers(1, 64))
    place = draw(st.integers(0, 64 - length))
    is_intel, is_signed = draw(st.booleans()), draw(st.booleans())
    # Motorola: bit 7 of byte 0 is the first in the order of the wire
    start = place if is_intel else 8 * (place // 8) + 7 - place % 8
    order = "little_endian" if is_intel else "big_endian"
    return Signal("s", start, length, byte_order=order, is_signed=is_signed)  # type: ignore[arg-type]
