"""What the docs tell of every fault is what happens."""

from __future__ import annotations

import pytest

from campaign.fault_docs import DOCS, documents


@pytest.mark.slow
@pytest.mark.timeout(2400)  # some eight minutes on a quiet machine
def test_what_the_docs_tell_of_every_fault_is_what_happens() -> None:
    told = documents()
    assert told == {path: path.read_text(encoding="utf-8") for path in told}, "make matrix"
    assert ", 0 wrong.**" in told[DOCS / "why-faults.md"]
