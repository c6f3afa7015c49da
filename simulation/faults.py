"""Faults as data: what goes wrong, where, when, how much; and the files that list them.

A file is TOML: a table `[[fault]]` for each, with `kind`, `target`, either `at_s` or `per_h`, and
by choice `for_s`, `value`, `share`.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.random import Generator

from simulation.fault_kinds import KINDS, TARGETS, FaultKind, Strikes, described

ALL = "*"
"""As a target: whichever the seed chooses, anew for each time."""
PER_H_MAX = 36_000.0
"""Ten a second: more is a share of the frames, not a rate of faults."""
S_PER_H = 3600.0
FIELDS = ("kind", "target", "at_s", "per_h", "for_s", "value", "share")


class FaultError(ValueError):
    """A fault that cannot be; names field, value and what is allowed, and file and line if any."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault.

    Attributes:
        kind: what goes wrong.
        target: what it strikes, by the kind's own names.
        at_s: when it begins, in true time.
        for_s: how long it lasts; infinity: until healed.
        value: how much, in the kind's unit.
        share: of the frames or readings that it strikes, 0 to 1.
    """

    kind: FaultKind
    target: str = ""
    at_s: float = 0.0
    for_s: float = math.inf
    value: float = math.nan
    share: float = 1.0

    def __post_init__(self) -> None:
        """Refuses what cannot be, and puts the kind's own value in place of none.

        Raises:
            FaultError: names field, value and range.
        """
        spec = KINDS[self.kind]
        targets = TARGETS[spec.strikes]
        if self.target not in targets:
            raise FaultError(f"target {self.target!r}: allowed for {self.kind} is {_any(targets)}")
        _check("at_s", self.at_s, 0.0, math.inf)
        _check("for_s", self.for_s, 0.0, math.inf, may_be_infinite=True)
        if math.isnan(self.value):
            object.__setattr__(self, "value", spec.default)
        _check("value", self.value, spec.low, spec.high)
        _check("share", self.share, 0.0, 1.0)
        if self.share != 1.0 and not spec.has_share:
            raise FaultError(f"share {self.share:g}: {self.kind} strikes always")

    def __str__(self) -> str:
        """One line: `at 3.2 s for 0.5 s: crash of Steering (stops for good, ...)`."""
        spec = KINDS[self.kind]
        span = "" if spec.is_instant or math.isinf(self.for_s) else f" for {self.for_s:g} s"
        of = f" of {self.target}" if self.target else ""
        share = "" if self.share == 1.0 else f", {self.share:.0%} of the time"
        what = f"{described(self.kind, self.value)}{share}"
        return f"at {self.at_s:g} s{span}: {self.kind}{of} ({what})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """A fault that comes again and again, at random times.

    Attributes:
        fault: what comes; its `at_s` does not count.
        per_h: how often, on average.
        targets: what it may strike in place of the fault's own target, drawn each time.
    """

    fault: Fault
    per_h: float
    targets: tuple[str, ...] = ()

    def draw(self, duration_s: float, rng: Generator) -> list[Fault]:
        """The faults of one run: a Poisson process of this rate."""
        count = int(rng.poisson(self.per_h * duration_s / S_PER_H))
        targets = self.targets
        drawn = []
        for at_s in sorted(float(x) for x in rng.uniform(0.0, duration_s, count)):
            target = self.fault.target
            if targets:
                target = targets[int(rng.integers(len(targets)))]
            drawn.append(replace(self.fault, at_s=at_s, target=target))
        return drawn


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultPlan:
    """What a file asks for."""

    fixed: tuple[Fault, ...] = ()
    rates: tuple[Rate, ...] = ()

    def draw(self, duration_s: float, rng: Generator) -> list[Fault]:
        """All faults of one run, in order of their beginning."""
        drawn = list(self.fixed)
        for rate in self.rates:
            drawn += rate.draw(duration_s, rng)
        return sorted(drawn, key=lambda fault: fault.at_s)


def read_faults(path: Path) -> str:
    """The text of a file of faults, not looked at yet.

    Raises:
        FaultError: it cannot be read: file and reason.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no UTF-8 text"
        raise FaultError(f"{path}: {reason}") from error


def parse_faults(
    text: str, name: str, targets: Mapping[FaultKind, tuple[str, ...]]
) -> FaultPlan:
    """What a file of faults asks for.

    Args:
        text: Of the file.
        name: Of the file, for errors.
        targets: What the car can have, and where (`fault_kinds.targets_of`).

    Raises:
        FaultError: a fault cannot be: file, line and reason.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FaultError(f"{name}: {error}") from error
    lines = [
        number
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip().startswith("[[fault]]")
    ]
    tables = data.get("fault")
    unknown = set(data) - {"fault"}
    if unknown or not isinstance(tables, list) or not tables or len(lines) != len(tables):
        raise FaultError(f"{name}: wanted is a list of [[fault]] tables and nothing else")
    fixed: list[Fault] = []
    rates: list[Rate] = []
    for line, table in zip(lines, tables, strict=True):
        try:
            entry = _entry(table, targets)
        except FaultError as error:
            raise FaultError(f"{name}: line {line}: {error}") from error
        if isinstance(entry, Rate):
            rates.append(entry)
        else:
            fixed.append(entry)
    return FaultPlan(fixed=tuple(fixed), rates=tuple(rates))


def _entry(table: dict[str, Any], targets: Mapping[FaultKind, tuple[str, ...]]) -> Fault | Rate:
    """One table of a file."""
    unknown = sorted(set(table) - set(FIELDS))
    if unknown:
        raise FaultError(f"{unknown[0]} is not known: allowed {_any(FIELDS)}")
    kind = table.get("kind")
    if kind not in list(FaultKind):
        raise FaultError(f"kind {kind!r}: allowed {_any(tuple(FaultKind))}")
    if kind not in targets:
        raise FaultError(f"kind {kind!r}: this car has no motor drives on its bus")
    if ("at_s" in table) == ("per_h" in table):
        raise FaultError("either at_s or per_h is wanted")
    numbers = {name: _number(name, table[name]) for name in FIELDS[2:] if name in table}
    target = table.get("target", "")
    if not isinstance(target, str):
        raise FaultError(f"target {target!r}: a text is wanted")
    per_h = numbers.pop("per_h", None)
    is_any = target == ALL and KINDS[FaultKind(kind)].strikes is not Strikes.NOTHING
    if is_any and per_h is None:
        raise FaultError("target '*' needs per_h: a fault at one time strikes one target")
    if is_any:
        target = targets[FaultKind(kind)][0]
    elif target in TARGETS[KINDS[FaultKind(kind)].strikes] and target not in targets[kind]:
        raise FaultError(f"target {target!r}: this car has a motor drive on its bus there")
    fault = Fault(kind=FaultKind(kind), target=target, **numbers)
    if per_h is None:
        return fault
    _check("per_h", per_h, 0.0, PER_H_MAX)
    return Rate(fault=fault, per_h=per_h, targets=targets[fault.kind] if is_any else ())


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise FaultError(f"{name} {value!r}: a number is wanted")
    if math.isnan(value):
        raise FaultError(f"{name} NaN: a number is wanted")
    return float(value)


def _check(
    name: str, value: float, low: float, high: float, *, may_be_infinite: bool = False
) -> None:
    if not low <= value <= high or (math.isinf(value) and not may_be_infinite):
        end = "or more" if math.isinf(high) else f"to {high:g}"
        raise FaultError(f"{name} {value:g}: allowed {low:g} {end}")


def _any(names: tuple[str, ...]) -> str:
    return ", ".join(name for name in names if name) or "none"
