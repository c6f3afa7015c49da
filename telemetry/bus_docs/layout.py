"""Where the signals of a message lie: the picture of its bits, row by row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Protocol

BITS = 8


class Placed(Protocol):
    """What a picture needs of a signal."""

    @property
    def name(self) -> str:
        """Unique in its message."""
        ...

    @property
    def start(self) -> int:
        """Start bit as the DBC counts."""
        ...

    @property
    def length(self) -> int:
        """In bits."""
        ...

    @property
    def byte_order(self) -> str:
        """`little_endian` (Intel) or `big_endian` (Motorola)."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A run of bits in one byte that belong together.

    Attributes:
        signal: Place of the signal in the list, or None for bits that are nobody's.
        width: In bits.
        text: Name and bits of the signal that lie here; of one that another hides, both names.
    """

    signal: int | None
    width: int
    text: str


def bits_of(signal: Placed) -> list[int]:
    """Numbers of the bits from the least significant on, byte times 8 plus place in the byte.

    As the DBC counts them: an Intel signal starts at its least significant bit and goes up, a
    Motorola signal starts at its most significant one and goes down each byte and on to the next.
    """
    if signal.byte_order == "little_endian":
        return list(range(signal.start, signal.start + signal.length))
    bits, bit = [], signal.start
    for _ in range(signal.length):
        bits.append(bit)
        bit = bit - 1 if bit % BITS else bit + 2 * BITS - 1
    return bits[::-1]


def rows_of(signals: Sequence[Placed], length: int) -> list[list[Cell]]:
    """A row of cells for each byte, bit 7 first.

    Args:
        signals: Of one message; bits beyond `length` are not drawn.
        length: In bytes.
    """
    owners: dict[int, list[tuple[int, int]]] = {}
    for place, signal in enumerate(signals):
        for number, bit in enumerate(bits_of(signal)):
            owners.setdefault(bit, []).append((place, number))
    return [list(_row(signals, owners, byte)) for byte in range(length)]


def _row(
    signals: Sequence[Placed], owners: dict[int, list[tuple[int, int]]], byte: int
) -> Iterator[Cell]:
    bits = [owners.get(BITS * byte + bit, []) for bit in reversed(range(BITS))]
    for places, run in groupby(bits, key=lambda found: tuple(place for place, _ in found)):
        cells = list(run)
        if not places:
            yield Cell(signal=None, width=len(cells), text="")
            continue
        parts = []
        for index, place in enumerate(places):
            high, low = cells[0][index][1], cells[-1][index][1]
            signal = signals[place]
            is_whole = high - low + 1 == signal.length
            span = f"[{high}]" if high == low else f"[{high}:{low}]"
            parts.append(signal.name if is_whole else f"{signal.name}{span}")
        yield Cell(signal=places[0], width=len(cells), text=", ".join(parts))
