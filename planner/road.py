"""Roads: a closed centre line with its width to either side, read from CSV or built by code."""

import math
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

POINTS_MIN = 10
POINTS_MAX = 200_000
FILE_BYTES_MAX = 20_000_000
STEP_M_MIN = 1e-3  # closer points are one point written twice
STEP_M_MAX = 50.0  # farther apart, the bends between the points would be invention
COORDINATE_M_MAX = 2e7  # half the earth's circumference: covers any map projection in metres
WIDTH_M_MAX = 1000.0
LENGTH_M_MIN = 50.0
LENGTH_M_MAX = 20_000.0
CLOSING_GAP_RATIO_MAX = 3.0  # closing step against the longest other step
CAMPUS = "campus"
_COLUMNS = "x_m,y_m,w_tr_right_m,w_tr_left_m"
_CIRCUITS = {"norisring": "Norisring", "oschersleben": "Oschersleben", "zandvoort": "Zandvoort"}

assert POINTS_MIN * STEP_M_MAX > LENGTH_M_MIN
assert math.tau * 10.0 > LENGTH_M_MIN  # a circle of the tightest radius in use is still a road


class RoadError(ValueError):
    """A road that cannot be read or driven; the message is one line saying where and why."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Road:
    """A closed road.

    Attributes:
        center_xy_m: Centre line in driving order, shape (N, 2), first point not repeated.
        width_right_m: From the centre line to the right edge, shape (N,).
        width_left_m: From the centre line to the left edge, shape (N,).
        name: What reports call it.
        closed: Always true: the last point joins the first.

    Raises:
        RoadError: If the points are no closed road; names the road and the point's index.
    """

    center_xy_m: FloatArray
    width_right_m: FloatArray
    width_left_m: FloatArray
    name: str
    closed: bool = True

    def __post_init__(self) -> None:
        count = len(self.center_xy_m)
        assert self.closed, "open roads are not supported"
        assert self.center_xy_m.shape == (count, 2)
        assert self.width_right_m.shape == (count,) and self.width_left_m.shape == (count,)
        table = np.column_stack([self.center_xy_m, self.width_right_m, self.width_left_m])
        found = _find_problem(table)
        if found is not None:
            index, reason = found
            raise RoadError(f"road {self.name!r}, point {index}: {reason}")


def _find_problem(table: FloatArray) -> tuple[int, str] | None:
    """Return the index of the first bad point and what is wrong with it, or None."""
    count = len(table)
    if not POINTS_MIN <= count <= POINTS_MAX:
        return count - 1, f"{count} points, a road has {POINTS_MIN} to {POINTS_MAX}"
    for index, row in enumerate(table.tolist()):
        reason = _find_bad_number(row)
        if reason is not None:
            return index, reason
    steps_m = np.hypot(*np.diff(table[:, :2], axis=0, append=table[:1, :2]).T)
    for index in np.flatnonzero(steps_m[:-1] < STEP_M_MIN).tolist():
        return index + 1, "repeats the point before it"
    for index in np.flatnonzero(steps_m[:-1] > STEP_M_MAX).tolist():
        return index + 1, (
            f"is {steps_m[index]:.1f} m from the point before it, "
            f"at most {STEP_M_MAX:.0f} m allowed"
        )
    if steps_m[-1] > CLOSING_GAP_RATIO_MAX * steps_m[:-1].max():
        return count - 1, (
            f"the last point is {steps_m[-1]:.1f} m from the first: not a closed loop"
        )
    length_m = float(steps_m.sum())
    if not LENGTH_M_MIN <= length_m <= LENGTH_M_MAX:
        return count - 1, (
            f"the loop is {length_m:.1f} m long, {LENGTH_M_MIN:.0f} to {LENGTH_M_MAX:.0f} m allowed"
        )
    return None


def _find_bad_number(row: list[float]) -> str | None:
    for name, value in zip(_COLUMNS.split(","), row, strict=True):
        if not math.isfinite(value):
            return f"{name} is {value}, a finite number is needed"
        lower, upper = (
            (0.0, WIDTH_M_MAX) if name.startswith("w_") else (-COORDINATE_M_MAX, COORDINATE_M_MAX)
        )
        if not lower <= value <= upper:
            return f"{name} is {value:g}, allowed is {lower:g} to {upper:g}"
    return None


def load_road(path: str | Path) -> Road:
    """Read a closed road from a CSV of four columns `x_m,y_m,w_tr_right_m,w_tr_left_m`.

    The format is that of the TUMFTM racetrack-database: lines starting with `#` are comments, the
    widths are measured from the centre line, right and left in driving direction. A last point
    equal to the first is dropped.

    Raises:
        RoadError: File, line and reason, in one line.
    """
    path = Path(path)
    rows: list[list[float]] = []
    line_numbers: list[int] = []
    for number, text in enumerate(_read_text(path).splitlines(), start=1):
        stripped = text.strip()
        if not stripped or stripped.startswith("#"):
            continue
        rows.append(_parse_row(path, number, stripped))
        line_numbers.append(number)
    if len(rows) < POINTS_MIN:
        raise RoadError(
            f"{path}: line {line_numbers[-1] if rows else 1}: {len(rows)} points, "
            f"a road needs at least {POINTS_MIN} lines of {_COLUMNS}"
        )
    if rows[0][:2] == rows[-1][:2]:
        rows.pop()
        line_numbers.pop()
    table = np.array(rows, dtype=np.float64)
    found = _find_problem(table)
    if found is not None:
        index, reason = found
        raise RoadError(f"{path}: line {line_numbers[index]}: {reason}")
    return Road(
        center_xy_m=table[:, :2].copy(),
        width_right_m=table[:, 2].copy(),
        width_left_m=table[:, 3].copy(),
        name=path.stem,
    )


def _read_text(path: Path) -> str:
    try:
        if not path.exists():
            raise RoadError(f"{path}: line 1: no such file")
        if not path.is_file():  # a pipe or a device would block or never end
            raise RoadError(f"{path}: line 1: not a regular file")
        if path.stat().st_size > FILE_BYTES_MAX:
            raise RoadError(f"{path}: line 1: larger than {FILE_BYTES_MAX // 1_000_000} MB")
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, RoadError):
            raise
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise RoadError(f"{path!s}: line 1: cannot be read ({reason})") from error
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        number = data[: error.start].count(b"\n") + 1
        raise RoadError(f"{path}: line {number}: not a text file (no valid UTF-8)") from error
    if "\0" in text:
        number = text[: text.index("\0")].count("\n") + 1
        raise RoadError(f"{path}: line {number}: not a text file (holds a zero byte)")
    return text


def _parse_row(path: Path, number: int, text: str) -> list[float]:
    fields = text.split(",")
    if len(fields) != 4:
        raise RoadError(f"{path}: line {number}: {len(fields)} columns, 4 are needed ({_COLUMNS})")
    row: list[float] = []
    for name, field in zip(_COLUMNS.split(","), fields, strict=True):
        try:
            row.append(float(field))
        except ValueError as error:
            shown = field.strip()[:30]
            raise RoadError(f"{path}: line {number}: {name} is not a number: {shown!r}") from error
    reason = _find_bad_number(row)
    if reason is not None:
        raise RoadError(f"{path}: line {number}: {reason}")
    return row


def builtin_tracks() -> tuple[str, ...]:
    """Return the names `open_road` knows without a file."""
    return (CAMPUS, *_CIRCUITS)


def open_road(name_or_path: str | Path) -> Road:
    """Return a built-in road by name (any case) or a road read from a CSV file.

    A file of the same name in the working directory does not hide a built-in road; write
    `./campus` for it.

    Raises:
        RoadError: If it is neither a built-in name nor a readable road.
    """
    key = str(name_or_path).lower()
    if key == CAMPUS:
        from planner.campus import build_campus  # it builds a Road, so it imports this module

        return build_campus()
    if key in _CIRCUITS:
        source = resources.files("planner") / "tracks" / f"{_CIRCUITS[key]}.csv"
        with resources.as_file(source) as path:
            return load_road(path)
    path = Path(name_or_path)
    if path.suffix == "" and not path.exists():
        raise RoadError(
            f"{name_or_path}: neither a file nor a built-in road ({', '.join(builtin_tracks())})"
        )
    return load_road(path)
