"""The list of properties in docs/safety.md is the list in the code."""

from __future__ import annotations

import inspect
from pathlib import Path

from oracle.judge import PROPERTIES

SAFETY = Path(__file__).parents[2] / "docs" / "safety.md"


def rows() -> list[str]:
    """Name and sentence of every property."""
    found = []
    for kind in PROPERTIES:
        sentence = inspect.cleandoc(str(kind.__doc__)).split("\n\n")[0].replace("\n", " ")
        found.append(f"| {kind.name} | {sentence} |")
    return found


def test_the_properties_in_the_docs_are_those_in_the_code() -> None:
    text = SAFETY.read_text(encoding="utf-8")
    block = text.split("<!-- properties -->")[1].split("<!-- /properties -->")[0]
    assert block.strip().splitlines()[2:] == rows()
