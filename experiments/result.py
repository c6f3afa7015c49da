"""What an experiment answers: rows of figures with a verdict each, pictures, tables and words."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from numpy.random import Generator

NAN = math.nan


class Goal(NamedTuple):
    """One thing that a row has to fulfil."""

    text: str
    holds: Callable[[Row], bool]
    """NaN in what it compares must come out as False."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One figure: the paper's, the paper's controller here, ours. NaN for what there is not."""

    id: str
    paper: str
    quantity: str
    unit: str
    paper_value: float = NAN
    baseline_value: float = NAN
    ours_value: float = NAN
    goals: tuple[Goal, ...]

    def __post_init__(self) -> None:
        assert self.goals, f"{self.id}: a row without a goal cannot fail"

    @property
    def tolerance(self) -> str:
        """The goals in words."""
        return "; ".join(goal.text for goal in self.goals)

    @property
    def passed(self) -> bool:
        """The verdict: every goal is met."""
        return all(goal.holds(self) for goal in self.goals)

    def to_plain(self) -> dict[str, Any]:
        """With the stable keys of `report.json`."""
        return {
            "id": self.id,
            "paper": self.paper,
            "quantity": self.quantity,
            "unit": self.unit,
            "paper_value": self.paper_value,
            "baseline_value": self.baseline_value,
            "ours_value": self.ours_value,
            "tolerance": self.tolerance,
            "pass": self.passed,
        }


def settled(row: Row) -> Row:
    """The row with its verdict for good: goals are functions, which stay in their process."""
    return replace(row, goals=(Goal(row.tolerance, _met if row.passed else _missed),))


def _met(row: Row) -> bool:
    return True


def _missed(row: Row) -> bool:
    return False


def baseline_within(share: float) -> Goal:
    """The paper's controller here gives the paper's figure."""
    return Goal(
        f"baseline within {100.0 * share:g} % of the paper",
        lambda row: abs(row.baseline_value - row.paper_value) <= share * abs(row.paper_value),
    )


def baseline_at_most_paper() -> Goal:
    """The paper gives a spread, and its controller here stays inside."""
    return Goal(
        "baseline inside the paper's spread",
        lambda row: abs(row.baseline_value) <= abs(row.paper_value),
    )


def baseline_at_most(limit: float, unit: str = "") -> Goal:
    """The paper gives words, and here they are a number."""
    return Goal(f"baseline <= {limit:g} {unit}".rstrip(), lambda row: row.baseline_value <= limit)


def ours_at_most(limit: float, unit: str = "") -> Goal:
    """Ours against a plain number."""
    return Goal(f"ours <= {limit:g} {unit}".rstrip(), lambda row: row.ours_value <= limit)


def ours_at_most_share(share: float, of: str = "paper") -> Goal:
    """Ours against a share of the paper's figure, or of the baseline's."""
    return Goal(
        f"ours <= {share:g} x {of}",
        lambda row: row.ours_value <= share * getattr(row, f"{of}_value"),
    )


def ours_within(share: float) -> Goal:
    """Ours is the paper's figure again."""
    return Goal(
        f"ours within {100.0 * share:g} % of the paper",
        lambda row: abs(row.ours_value - row.paper_value) <= share * abs(row.paper_value),
    )


def ours_near_baseline(share: float) -> Goal:
    """Two ways to one figure agree."""
    return Goal(
        f"ours within {100.0 * share:g} % of the baseline",
        lambda row: abs(row.ours_value - row.baseline_value) <= share * abs(row.baseline_value),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOfWords:
    """A table below the verdicts: what shows more than a verdict can."""

    title: str
    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one experiment found."""

    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    """What was assumed, what differs from the paper, in sentences."""
    tables: tuple[TableOfWords, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What an experiment is given."""

    seed: int
    rng: Generator
    """Of this experiment alone, so that it comes out the same without the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """One experiment of a paper."""

    id: str
    """As in `uah-vernier`; also the name of its picture."""
    title: str
    source: str
    """Where in the paper."""
    run: Callable[[Setting, Path], Outcome] = field(repr=False)
    """Draws the picture in the form of the paper's figure into the file, and answers."""
