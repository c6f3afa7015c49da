"""DBC files: ours, foreign ones and broken ones, strictly and relaxed."""

from __future__ import annotations

from pathlib import Path

import pytest

from dbc.database import HARNESS_DBC, VEHICLE_DBC, dbc_text
from telemetry.databases import DatabaseError, load_databases, nearest

HEAD = 'VERSION ""\nBU_: A\n'
M = 'BO_ 1 M: 2 A\n SG_ a : 0|8@1+ (1,0) [0|0] "" A\n'
N = 'BO_ 2 N: 2 A\n SG_ b : 8|8@1+ (1,0) [0|0] "" A\n'

BROKEN = {
    "bad syntax": (M + ' SG_ b : oops\n SG_ c : 8|8@1+ (1,0) [0|0] "" A\n', 5, "bad syntax at"),
    "no semicolon": (M + N + 'VAL_ 1 a 1 "x"\nVAL_ 2 b 1 "x" ;\n', 8, "bad syntax at column 1"),
    "cut off": (M + N + "VAL_ 1 a 1 \"x", 7, "bad syntax at"),
    "overlap": (M + ' SG_ b : 4|8@1+ (1,0) [0|0] "" A\n', 5, "b and a are overlapping"),
    "too long": (M + ' SG_ b : 8|16@1+ (1,0) [0|0] "" A\n', 5, "b does not fit in message M"),
    "no length": (M + ' SG_ b : 8|0@1+ (1,0) [0|0] "" A\n', 5, "is not greater than 0"),
    "identifier": ("BO_ 4096 X: 2 A\n" + M, 3, "more than 11 bits in message X"),
    "twice": (M + N.replace("BO_ 2", "BO_ 1"), 5, "N has the identifier 0x1 of M"),
    "attribute": (M + 'BA_ "Foo" BO_ 1 5;\n', 5, "'Foo' is not defined"),
    "value": (M + 'VAL_ 7 z 1 "x" ;\n', 5, "unused VAL_"),
    "type": (M + "SIG_VALTYPE_ 9 a : 1;\n", 5, "unused SIG_VALTYPE_"),
    "encoding": (M.replace('""', '"\x81"'), 4, "byte 0x81 is neither UTF-8 nor cp1252"),
}


def written(folder: Path, text: str, name: str = "some.dbc") -> Path:
    file = folder / name
    file.write_bytes((HEAD + text).encode("latin-1"))
    return file


@pytest.mark.parametrize("case", list(BROKEN))
def test_broken_file_is_refused_with_line_and_loaded_relaxed(case: str, tmp_path: Path) -> None:
    text, line, reason = BROKEN[case]
    file = written(tmp_path, text)
    with pytest.raises(DatabaseError) as error:
        load_databases([file])
    told = str(error.value)
    assert told.startswith(f"{file}: line {line}: ") and reason in told and "--relaxed" in told
    assert "\n" not in told
    databases = load_databases([file], relaxed=True)
    assert "M" in [message.name for message in databases.messages]
    assert databases.notes and f"{file}: line " in databases.notes[0]


def test_relaxed_loading_keeps_what_stands_beside_the_broken_statement(tmp_path: Path) -> None:
    text = M + " SG_ b : oops\n" + ' SG_ c : 8|8@1+ (1,0) [0|0] "" A\n' + N
    databases = load_databases([written(tmp_path, text)], relaxed=True)
    assert [[s.name for s in m.signals] for m in databases.messages] == [["a", "c"], ["b"]]


@pytest.mark.parametrize("text", ["", "hello world\n", "\0\1\2", "BU_: A\n"])
@pytest.mark.parametrize("relaxed", [False, True])
def test_file_that_is_no_dbc_is_refused_in_any_case(
    text: str, relaxed: bool, tmp_path: Path
) -> None:
    file = tmp_path / "x.dbc"
    file.write_text(text)
    with pytest.raises(DatabaseError, match="line 1: no DBC: there is no message"):
        load_databases([file], relaxed=relaxed)


def test_missing_file_is_refused() -> None:
    with pytest.raises(DatabaseError, match=r"nix\.dbc: cannot be read: No such file"):
        load_databases(["nix.dbc"])


def test_utf_16_is_read_relaxed_alone(tmp_path: Path) -> None:
    file = tmp_path / "x.dbc"
    file.write_bytes(dbc_text(VEHICLE_DBC).encode("utf-16"))
    with pytest.raises(DatabaseError, match="line 1: the text is UTF-16"):
        load_databases([file])
    assert load_databases([file], relaxed=True).named("STEER_STATUS").frame_id == 0x182


def test_windows_text_needs_no_relaxing(tmp_path: Path) -> None:
    databases = load_databases([written(tmp_path, M.replace('""', '"\xb0C"'))])
    assert databases.messages[0].signals[0].unit == "\xb0C"


def test_cut_inside_a_message_is_told(tmp_path: Path) -> None:
    databases = load_databases([written(tmp_path, (M + N).rstrip())])
    assert databases.notes[0].endswith("the text ends in message N: was it cut off?")
    with pytest.raises(DatabaseError, match="'B' is no node: was it cut off"):
        load_databases([written(tmp_path, (M + N).rstrip("A\n") + "B")])


def test_buses_of_their_own_may_use_the_same_identifiers() -> None:
    lines = dbc_text(HARNESS_DBC).splitlines()
    line = 1 + next(n for n, text in enumerate(lines) if text.startswith(f"BO_ {0x202} "))
    with pytest.raises(DatabaseError, match=rf"harness: line {line}: .*CHANNEL=FILE"):
        load_databases(["vehicle", "harness"])
    databases = load_databases(["vehicle", "vcan1=harness"])
    found = [databases.find(0x202, False, channel) for channel in ("vcan0", "vcan1")]
    assert [m.name for m in found if m] == ["STEER_COMMAND", "STEERING_SENSORS"]
    assert databases.find(0x202, True) is None


def test_name_used_twice_is_made_another(tmp_path: Path) -> None:
    databases = load_databases([written(tmp_path, M + N.replace("N:", "M:"))])
    assert [message.name for message in databases.messages] == ["M", "M_0x2"]
    assert "its name is used twice" in databases.notes[0]


def test_default_is_our_own_and_knows_that_it_is(tmp_path: Path) -> None:
    own = load_databases()
    assert own.is_own(own.messages[0])
    other = load_databases([written(tmp_path, M)])
    assert not other.is_own(other.messages[0])


def test_names_may_be_written_as_their_class_and_mistyped_ones_are_answered() -> None:
    databases = load_databases()
    status = databases.named("SteerStatus")
    assert status.name == "STEER_STATUS"
    with pytest.raises(DatabaseError, match="no message 'STEER_STATU': did you mean STEER_STATUS"):
        databases.named("STEER_STATU")
    with pytest.raises(DatabaseError, match="did you mean steering_wheel_angle_rad"):
        databases.signal(status, "steering_wheel_angle")
    with pytest.raises(DatabaseError, match="did you mean Steering"):
        databases.of_node("Stering")
    assert {m.name for m in databases.of_node("Steering")} >= {"STEER_STATUS", "STEER_DRIVER"}
    assert nearest("zzz", ["b", "a"]) == ": there are a, b" and nearest("zzz", []) == ""
