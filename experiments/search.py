"""A local search that anybody can repeat: ever to the best neighbour, until none is better.

Neighbours are a fixed step away along one number; so the search ends at the same point every time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

NEAR: Final = 0.10
"""The goal of a fit: a figure off by more than this is missed."""

Point = dict[str, float]
Score = tuple[int, float]
"""Figures missed, and the sum of squares of what they are off; less is better."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Search(ABC):
    """What is searched."""

    start: Point
    steps: Point
    """Of each number, to either side."""
    pinned: Point
    """What the search ends at, as the code has it; other numbers may be among them."""
    highest: Mapping[str, float] = field(default_factory=dict)
    """Of numbers that make no sense beyond; none makes any at 0 and below."""

    @abstractmethod
    def score(self, point: Point) -> Score:
        """How well a point fits."""

    def neighbours(self, point: Point) -> Iterator[Point]:
        """A step along each number to either side, within what makes sense."""
        for name, step in self.steps.items():
            for value in (point[name] - step, point[name] + step):
                if 0.0 < value <= self.highest.get(name, value):
                    yield {**point, name: value}

    def walk(self, point: Point) -> Iterator[tuple[Point, Score]]:
        """From a point to ever better ones."""
        score = self.score(point)
        yield point, score
        while True:
            scored = [(self.score(other), other) for other in self.neighbours(point)]
            best, other = min(scored, key=lambda pair: pair[0])
            if best >= score:
                return
            point, score = other, best
            yield point, score


def tell(name: str, search: Search) -> Iterator[str]:
    """A line for each step of a walk."""
    for point, (missed, squares) in search.walk(search.start):
        numbers = ", ".join(f"{number} {value:.4g}" for number, value in point.items())
        yield f"{name}: {missed} missed, {squares:.4f}: {numbers}"
