"""Reading a vehicle file: every number with its source, all that is wrong named with its line."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import MISSING, Field, dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from vehicles.vehicle import (
    STOP_MARGIN,
    Brake,
    BusSettings,
    DriverPolicy,
    Drives,
    Envelope,
    Geometry,
    Policy,
    Steering,
    Times,
    Traction,
    Vehicle,
    VehicleError,
)

SECTIONS: dict[str, type[Any]] = {
    "geometry": Geometry,
    "steering": Steering,
    "traction": Traction,
    "brake": Brake,
    "envelope": Envelope,
    "times": Times,
    "policy": Policy,
    "bus": BusSettings,
}

OPTIONAL_SECTIONS: dict[str, type[Any]] = {"drives": Drives}
"""What not every car has; a section that is there must be whole."""

RELATIONS: tuple[tuple[str, str, Callable[[Vehicle], float], str], ...] = (
    ("brake.on_time_s_max", "traction", lambda vehicle: STOP_MARGIN * vehicle.longest_stop_s,
     "three times the longest stop"),
    ("steering.sensor_angle_rad_max", "steering",
     lambda vehicle: vehicle.steering.wheel_angle_rad_max + abs(vehicle.steering.zero_rad),
     "steering.wheel_angle_rad_max and the size of steering.zero_rad"),
    ("traction.speed_mps_max", "traction",
     lambda vehicle: vehicle.traction.reverse_speed_mps_max, "traction.reverse_speed_mps_max"),
    ("envelope.speed_mps_max", "traction",
     lambda vehicle: vehicle.traction.speed_mps_max, "traction.speed_mps_max"),
    ("envelope.wheel_angle_rad_max", "steering",
     lambda vehicle: vehicle.steering.wheel_angle_rad_max, "steering.wheel_angle_rad_max"),
    ("envelope.wheel_rate_radps_max", "steering",
     lambda vehicle: vehicle.steering.wheel_rate_radps_max, "steering.wheel_rate_radps_max"),
    ("brake.deceleration_mps2_full", "brake",
     lambda vehicle: vehicle.brake.deceleration_mps2_min, "brake.deceleration_mps2_min"),
    ("bus.foreign_id_max", "bus",
     lambda vehicle: vehicle.bus.foreign_id_min, "bus.foreign_id_min"),
)
"""A field, the other section it must fit, the least it may be, and in words."""

NODE_ID_FIELDS = tuple(field.name for field in fields(Drives) if field.name.endswith("node_id"))
"""Each names another node."""

_HEADER = re.compile(r"\s*\[\s*([\w-]+)\s*\]")
_KEY = re.compile(r"\s*([\w-]+)\s*=")
_LINE_OF_ERROR = re.compile(r"at line (\d+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """Something in a vehicle file that cannot be used.

    Attributes:
        line: Of the field, of its section if the field is missing, or 1.
        text: Field, value and allowed range.
    """

    line: int
    text: str


DEFAULT: Final = "tabby_evo"
"""The vehicle where none is named."""


def known_vehicles() -> list[str]:
    """Names of the vehicles shipped with the package."""
    return sorted(
        item.name.removesuffix(".toml")
        for item in files("vehicles").iterdir()
        if item.name.endswith(".toml")
    )


def load_vehicle(name_or_path: str) -> Vehicle:
    """A shipped vehicle by name, or a file by path (anything ending in `.toml`).

    Raises:
        VehicleError: The file is missing or holds something that cannot be used.
    """
    return parse_vehicle(vehicle_text(name_or_path), _origin(name_or_path))


def vehicle_text(name_or_path: str) -> str:
    """The text of a vehicle file, not looked at yet; names and paths as for `load_vehicle`.

    Raises:
        VehicleError: There is no such file.
    """
    if is_file(name_or_path):
        try:
            return Path(name_or_path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise VehicleError(f"{name_or_path}: cannot be read: {error}") from error
    if name_or_path not in known_vehicles():
        known = ", ".join(known_vehicles())
        raise VehicleError(
            f"vehicle {name_or_path!r} is not known: allowed {known}, or a path ending in .toml"
        )
    return files("vehicles").joinpath(_origin(name_or_path)).read_text(encoding="utf-8")


def is_file(name_or_path: str) -> bool:
    """Whether this is a path of the user's own, and no name of a shipped vehicle."""
    return name_or_path.endswith(".toml")


def _origin(name_or_path: str) -> str:
    return name_or_path if is_file(name_or_path) else f"{name_or_path}.toml"


def parse_vehicle(text: str, origin: str) -> Vehicle:
    """A vehicle from TOML text; `origin` names it in errors.

    Raises:
        VehicleError: Naming origin, field, value and allowed range of the first problem.
    """
    vehicle, problems = read_vehicle(text)
    if vehicle is None:
        raise VehicleError(f"{origin}: {problems[0].text}")
    return vehicle


def read_vehicle(text: str) -> tuple[Vehicle | None, list[Problem]]:
    """A vehicle from TOML text, or all that is wrong with it, in the order of its lines."""
    reading = _Reading(text)
    vehicle = reading.vehicle()
    problems = sorted(reading.problems, key=lambda problem: problem.line)
    return (None if problems else vehicle), problems


class _Reading:
    """One file, and what was found wrong with it so far."""

    def __init__(self, text: str) -> None:
        self.problems: list[Problem] = []
        self._text = text
        self._lines = _lines_of(text)

    def vehicle(self) -> Vehicle | None:
        """The vehicle as far as it can be read: a section with a problem is None."""
        try:
            document = tomllib.loads(self._text)
        except tomllib.TOMLDecodeError as error:
            place = _LINE_OF_ERROR.search(str(error))
            line = int(place[1]) if place else 1 + self._text.count("\n")
            self.problems.append(Problem(line=line, text=f"not valid TOML: {error}"))
            return None
        name = document.pop("name", None)
        if not isinstance(name, str) or not name:
            self._refuse("name", f"name = {name!r}: a non-empty text is wanted")
        known = SECTIONS | OPTIONAL_SECTIONS
        for section in document.keys() - known.keys():
            self._refuse(section, f"[{section}] is not known: allowed {', '.join(known)}")
        parts = {
            section: self._section(section, document.get(section), kind)
            for section, kind in known.items()
            if section in SECTIONS or section in document
        }
        vehicle = Vehicle(name=str(name), text=self._text, **parts)
        for field, what in _broken_relations(vehicle):
            self._refuse(field, what)
        return vehicle

    def _refuse(self, where: str, text: str) -> None:
        section = where.partition(".")[0]
        line = self._lines.get(where) or self._lines.get(section) or 1
        self.problems.append(Problem(line=line, text=text))

    def _section(self, section: str, table: object, kind: type[Any]) -> Any:
        if not isinstance(table, dict):
            self._refuse(section, f"{section}: the section is missing")
            return None
        wanted = {f.name: f for f in fields(kind)}
        for unknown in table.keys() - wanted.keys():
            where = f"{section}.{unknown}"
            self._refuse(where, f"{where} is not known: allowed {', '.join(wanted)}")
        count = len(self.problems)
        values = {
            name: self._field(f"{section}.{name}", table.get(name), spec)
            for name, spec in wanted.items()
        }
        return kind(**values) if len(self.problems) == count else None

    def _field(
        self, where: str, entry: object, spec: Field[Any]
    ) -> float | DriverPolicy | None:
        if entry is None and spec.default is not MISSING:
            return float(spec.default)
        if not isinstance(entry, dict) or entry.keys() != {"value", "source"}:
            self._refuse(where, f'{where} is missing: wanted {{ value = ..., source = "..." }}')
            return None
        if not isinstance(entry["source"], str) or not entry["source"].strip():
            self._refuse(where, f"{where}: the source is missing: where is it from?")
        return self._value(where, entry["value"], dict(spec.metadata))

    def _value(
        self, where: str, value: Any, metadata: dict[str, float]
    ) -> float | DriverPolicy | None:
        if not metadata:
            if value in list(DriverPolicy):
                return DriverPolicy(str(value))
            self._refuse(where, f"{where} = {value!r}: allowed {', '.join(DriverPolicy)}")
            return None
        low, high = metadata["low"], metadata["high"]
        is_whole = metadata.get("whole", False)
        wanted = int if is_whole else int | float
        is_number = isinstance(value, wanted) and not isinstance(value, bool)
        if is_number and low <= value <= high:
            return int(value) if is_whole else float(value)
        kind = ", whole" if is_whole else ""
        self._refuse(where, f"{where} = {value!r}: allowed {low:g} to {high:g}{kind}")
        return None


def _lines_of(text: str) -> dict[str, int]:
    """Where sections and their fields are, by `section` and `section.field`; the first wins."""
    lines: dict[str, int] = {}
    section = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            section = header[1]
            lines.setdefault(section, number)
        elif key := _KEY.match(line):
            lines.setdefault(f"{section}.{key[1]}" if section else key[1], number)
    return lines


def _broken_relations(vehicle: Vehicle) -> Iterator[tuple[str, str]]:
    """Fields that do not fit others, and what is wrong with them; unread sections are left out."""
    for where, other, low_of, why in RELATIONS:
        section, field = where.split(".")
        if getattr(vehicle, section) is None or getattr(vehicle, other) is None:
            continue
        value, low = getattr(getattr(vehicle, section), field), low_of(vehicle)
        if value < low:
            yield where, f"{where} = {value:g}: must be at least {why} ({low:g})"
    taken: dict[int, str] = {}
    for field in NODE_ID_FIELDS if vehicle.drives is not None else ():
        node_id = getattr(vehicle.drives, field)
        if node_id in taken:
            where = f"drives.{field}"
            yield where, f"{where} = {node_id}: {taken[node_id]} has it: one node, one id"
        taken.setdefault(node_id, field)
