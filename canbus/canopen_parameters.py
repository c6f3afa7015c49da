"""Parameters of a node as scaled integers: value in SI = raw / steps per unit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol, Self

INTEGER32: Final = 0x04
UNSIGNED32: Final = 0x07


class EdsVariable(Protocol):
    """What an EDS says of a variable."""

    name: str
    subindex: int
    unit: str
    factor: float
    min: int | None
    max: int | None
    data_type: int | None

    def __len__(self) -> int:
        """Length in bits."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One member of the parameter record, as the EDS describes it.

    Attributes:
        name: name with unit, such as `command_timeout_s`.
        subindex: place in the record.
        unit: for messages.
        factor: SI units per raw step (the EDS's Factor).
        raw_min: smallest raw value.
        raw_max: largest raw value.
    """

    name: str
    subindex: int
    unit: str
    factor: float
    raw_min: int
    raw_max: int

    def __post_init__(self) -> None:
        """Refuse limits that hold no value and factors that make none."""
        if not (self.factor > 0 and math.isfinite(self.factor)):
            raise ValueError(f"EDS: Factor of {self.name}: {self.factor}; must be above 0")
        if self.raw_min > self.raw_max:
            raise ValueError(f"EDS: LowLimit of {self.name} is above its HighLimit")

    @classmethod
    def from_eds(cls, variable: EdsVariable) -> Self:
        """The parameter that `variable` describes. Raises ValueError naming what it lacks."""
        if variable.data_type not in (INTEGER32, UNSIGNED32):
            raise ValueError(f"EDS: {variable.name} must be INTEGER32 or UNSIGNED32")
        if variable.min is None or variable.max is None:
            raise ValueError(f"EDS: {variable.name} needs LowLimit and HighLimit")
        return cls(
            name=variable.name,
            subindex=variable.subindex,
            unit=variable.unit,
            factor=variable.factor,
            raw_min=variable.min,
            raw_max=variable.max,
        )

    @property
    def steps_per_unit(self) -> float:
        """Raw steps per SI unit; whole where it can be, so that 50 steps of 0.001 are 0.05."""
        exact = 1 / self.factor
        return round(exact) if math.isclose(exact, round(exact), rel_tol=1e-12) else exact

    def si(self, raw: int) -> float:
        """The value in SI of a raw number."""
        return raw / self.steps_per_unit

    def raw(self, value: float) -> int:
        """The raw number nearest to a value in SI.

        Raises:
            ValueError: not finite or outside the limits; names parameter, value and limits.
        """
        raw = round(value * self.steps_per_unit) if math.isfinite(value) else None
        if raw is None or not self.raw_min <= raw <= self.raw_max:
            low, high = self.si(self.raw_min), self.si(self.raw_max)
            raise ValueError(
                f"parameter {self.name}: {value} {self.unit}; allowed {low:g} to {high:g}"
            )
        return raw


def raw_values(parameters: Iterable[Parameter], values: Mapping[str, float]) -> dict[int, int]:
    """Raw value per sub-index for `values` in SI, which must name exactly the `parameters`.

    Raises:
        ValueError: a name is unknown or missing, or a value is not allowed; the message names it.
    """
    by_name = {parameter.name: parameter for parameter in parameters}
    for problem, wrong in (
        ("unknown", values.keys() - by_name.keys()),
        ("missing", by_name.keys() - values.keys()),
    ):
        if wrong:
            raise ValueError(
                f"parameter {problem}: {', '.join(sorted(wrong))}; the EDS has {', '.join(by_name)}"
            )
    return {
        parameter.subindex: parameter.raw(values[parameter.name]) for parameter in by_name.values()
    }


def raw_in_units(variable: EdsVariable, value: int, unit: int) -> int:
    """`value` in whole `unit`s of the object `variable`, such as ns in an object of 100 us.

    Raises:
        ValueError: not a whole number of units, negative or too large for the object.
    """
    raw, rest = divmod(value, unit)
    high = variable.max if variable.max is not None else (1 << len(variable)) - 1
    if rest or not 0 <= raw <= high:
        raise ValueError(f"{variable.name}: {value}; allowed 0 to {high * unit} in steps of {unit}")
    return raw
