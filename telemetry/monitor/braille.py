"""A curve in braille characters: two dots by four in each cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

DOTS_WIDE: Final = 2
DOTS_HIGH: Final = 4
_BLANK: Final = 0x2800
_DOT: Final = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
"""Bit of a dot, by column and row (Unicode, block Braille Patterns)."""


def curve(
    points: Sequence[tuple[float, float]], width: int, height: int,
    x_range: tuple[float, float], y_range: tuple[float, float],
) -> list[str]:  # fmt: skip
    """Lines of text with the points in them, the neighbours in x joined by a vertical line.

    Args:
        points: x and y, by rising x. Those that are NaN or outside the ranges are left out.
        width: Cells in a line.
        height: Lines.
        x_range: x of the left and the right edge.
        y_range: y of the lower and the upper edge.
    """
    columns, rows = width * DOTS_WIDE, height * DOTS_HIGH
    cells = [[0] * width for _ in range(height)]
    before: tuple[int, int] | None = None
    for x, y in points:
        if not math.isfinite(y):
            before = None
            continue
        column = _place(x, x_range, columns)
        row = _place(y, y_range, rows)
        if column is None or row is None:
            before = None
            continue
        row = rows - 1 - row
        first = last = row
        if before is not None and column - before[0] <= 1:
            first, last = min(row, before[1]), max(row, before[1])
        for dot in range(first, last + 1):
            cells[dot // DOTS_HIGH][column // DOTS_WIDE] |= _DOT[column % 2][dot % DOTS_HIGH]
        before = column, row
    return ["".join(chr(_BLANK | bits) for bits in line) for line in cells]


def _place(value: float, limits: tuple[float, float], count: int) -> int | None:
    low, high = limits
    if high <= low:
        return count // 2
    place = (value - low) / (high - low)
    return min(int(place * count), count - 1) if 0 <= place <= 1 else None
