"""`make matrix`: writes docs/fault-matrix.md and docs/why-faults.md; a test compares."""

from __future__ import annotations

import sys
from pathlib import Path

from campaign.explained import explained
from campaign.futures import futures
from campaign.matrix import matrix

DOCS = Path(__file__).parents[1] / "docs"


def documents() -> dict[Path, str]:
    """Both, by path: every fault runs once for them.

    Raises:
        AssertionError: A property broke, or a fault was missed.
    """
    found = list(futures())
    return {
        DOCS / "fault-matrix.md": matrix([future.result for future in found]),
        DOCS / "why-faults.md": explained(found),
    }


def main() -> int:
    """Writes them."""
    for path, text in documents().items():
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
