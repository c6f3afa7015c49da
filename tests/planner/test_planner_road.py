"""Roads: what is read, and how everything else is refused."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planner.road import Road, RoadError, builtin_tracks, load_road, open_road


def circle_rows(count: int = 24, radius_m: float = 30.0) -> list[str]:
    angles = np.arange(count) * (2.0 * np.pi / count)
    return [f"{radius_m * np.cos(a):.6f},{radius_m * np.sin(a):.6f},3.0,4.0" for a in angles]


def write(folder: Path, rows: list[str]) -> Path:
    path = folder / "ring.csv"
    path.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(rows) + "\n")
    return path


def changed(index: int, text: str) -> Callable[[], list[str]]:
    def rows() -> list[str]:
        result = circle_rows()
        result[index] = text
        return result

    return rows


def test_csv_is_read_in_order_with_its_widths(tmp_path: Path) -> None:
    road = load_road(write(tmp_path, circle_rows()))
    assert road.name == "ring" and road.closed
    assert road.center_xy_m.shape == (24, 2)
    assert road.center_xy_m[0] == pytest.approx([30.0, 0.0])
    assert set(road.width_right_m) == {3.0} and set(road.width_left_m) == {4.0}


def test_last_point_equal_to_the_first_is_dropped(tmp_path: Path) -> None:
    rows = circle_rows()
    assert len(load_road(write(tmp_path, [*rows, rows[0]])).center_xy_m) == 24


def test_byte_order_mark_windows_line_ends_and_blank_lines_are_read(tmp_path: Path) -> None:
    path = tmp_path / "ring.csv"
    path.write_bytes(b"\xef\xbb\xbf# x\r\n\r\n" + "\r\n".join(circle_rows()).encode())
    assert len(load_road(path).center_xy_m) == 24


BAD_ROWS = [
    (changed(3, "1,2,3"), "line 5: 3 columns, 4 are needed"),
    (changed(3, "1,2,3,4,5"), "line 5: 5 columns, 4 are needed"),
    (changed(3, "1;2;3;4"), "line 5: 1 columns, 4 are needed"),
    (changed(0, "x,y,w,w"), "line 2: x_m is not a number: 'x'"),
    (changed(7, "1,,3,4"), "line 9: y_m is not a number: ''"),
    (changed(7, "1,nan,3,4"), "line 9: y_m is nan, a finite number"),
    (changed(7, "-inf,1,3,4"), "line 9: x_m is -inf, a finite number"),
    (changed(7, "1e300,1,3,4"), "line 9: x_m is 1e[+]300, allowed is"),
    (changed(7, "0,0,-0.5,4"), "line 9: w_tr_right_m is -0.5, allowed is 0 to 1000"),
    (changed(7, "0,0,0.5,-4"), "line 9: w_tr_left_m is -4, allowed is 0 to 1000"),
    (changed(7, "900,0,3,4"), "line 9: is .* m from the point before it, at most 50 m"),
    (changed(7, circle_rows()[6]), "line 9: repeats the point before it"),
    (lambda: circle_rows()[:14], "line 15: the last point is .* not a closed loop"),
    (lambda: circle_rows(9), "line 10: 9 points, a road needs at least 10"),
    (list, "line 1: 0 points, a road needs at least 10"),
    (lambda: circle_rows(24, 5.0), "line 25: the loop is 31.3 m long, 50 to 20000 m"),
]


@pytest.mark.parametrize(("rows", "reason"), BAD_ROWS)
def test_bad_csv_is_refused_with_file_line_and_reason(
    tmp_path: Path, rows: Callable[[], list[str]], reason: str
) -> None:
    path = write(tmp_path, rows())
    with pytest.raises(RoadError, match=reason) as caught:
        load_road(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: line ") and "\n" not in message


def test_missing_file_folder_and_pipe_are_refused_by_name(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    for path, reason in (
        (tmp_path / "none.csv", "no such file"),
        (tmp_path, "not a regular file"),
        (tmp_path / "pipe.csv", "not a regular file"),
    ):
        with pytest.raises(RoadError, match=f"{path}: line 1: {reason}"):
            load_road(path)


@pytest.mark.parametrize("data", [b"1,2,3,4\n\xff\xfe\x00", b"1,2,3,4\n\x00\x01"])
def test_binary_file_is_refused_at_its_line(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "picture.csv"
    path.write_bytes(data)
    with pytest.raises(RoadError, match="line 2: not a text file"):
        load_road(path)


def test_path_no_system_accepts_is_refused_not_crashed_on() -> None:
    for name in ("a\0b.csv", "x" * 5000 + ".csv"):
        with pytest.raises(RoadError):
            load_road(name)
        with pytest.raises(RoadError):
            open_road(name)


def test_road_built_by_code_is_checked_too() -> None:
    angles = np.arange(20) * (2.0 * np.pi / 20)
    xy = 30.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    width = np.full(20, 3.0)
    width[4] = -1.0
    with pytest.raises(RoadError, match="road 'ring', point 4: w_tr_right_m is -1"):
        Road(center_xy_m=xy, width_right_m=width, width_left_m=abs(width), name="ring")


def test_built_in_roads_open_by_name_in_any_case() -> None:
    assert builtin_tracks() == ("campus", "norisring", "oschersleben", "zandvoort")
    lengths_m = {"campus": 800, "norisring": 2296, "oschersleben": 3692, "zandvoort": 4316}
    for name in builtin_tracks():
        xy = open_road(name.title()).center_xy_m
        steps = np.hypot(*np.diff(xy, axis=0, append=xy[:1]).T)
        assert steps.sum() == pytest.approx(lengths_m[name], abs=1.0)


def test_unknown_name_lists_the_built_in_ones() -> None:
    with pytest.raises(RoadError, match=r"monza: neither a file nor a built-in road \(campus, nor"):
        open_road("monza")


def test_path_opens_as_a_file(tmp_path: Path) -> None:
    assert open_road(write(tmp_path, circle_rows())).name == "ring"
