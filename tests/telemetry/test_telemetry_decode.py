"""Logs as tables: every signal as cantools reads it, nothing lost, nothing interpolated."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cantools.database.can import Message, Signal
from hypothesis import given
from hypothesis import strategies as st

from canbus.frame import Frame
from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import Mode, SteerStatus
from dbc.protection import crc
from simulation.trace import TraceRow
from simulation.world import World
from telemetry.databases import Databases, load_databases
from telemetry.decode.bits import is_crc_right, raw_of
from telemetry.decode.export import columns_of, decode_log, write_csv, write_parquet
from telemetry.decode.lines import lines_of
from telemetry.decode.tables import Decoded, Decoder
from telemetry.logs.frames import ChannelNames, FrameFlag, LogFrame
from telemetry.logs.frames import columns_of as as_columns
from tests.telemetry.drawn_signals import drawn_signals
from tests.telemetry.test_telemetry_bus_docs import FOREIGN
from vehicles import load_vehicle

NONE = FrameFlag(0)
MUX = """VERSION ""
NS_ :
BS_:
BU_: Pump
BO_ 100 Level: 8 Pump
 SG_ page M : 0|4@1+ (1,0) [0|15] "" Pump
 SG_ depth m0 : 15|16@0- (0.01,-5) [-400|400] "m" Pump
 SG_ heat m1 : 8|12@1+ (0.5,0) [0|100] "degC" Pump
 SG_ count : 32|32@1+ (2,1) [0|0] "" Pump
VAL_ 100 heat 4095 "broken" 1 "cold" ;
"""


def frame(can_id: int, data: bytes, *, channel: str = "can0", time_ns: int = 0,
          flags: FrameFlag = NONE) -> LogFrame:  # fmt: skip
    return LogFrame(time_ns, channel, can_id, flags, len(data), data)


def decode(frames: list[LogFrame], databases: Databases, **options: Any) -> Decoded:
    columns = as_columns(frames, list(range(1, len(frames) + 1)), ChannelNames())
    return Decoder(databases, **options).decode(columns)


def databases_of(text: str, folder: Path) -> Databases:
    file = folder / "x.dbc"
    file.write_text(text)
    return load_databases([file])


@pytest.fixture(scope="module")
def drive() -> list[TraceRow]:
    world = World(load_vehicle("tabby_evo"), 1)
    world.run_for(1.0)
    return list(world.trace.rows)


def logged(rows: list[TraceRow]) -> list[LogFrame]:
    return [frame(f.can_id, f.data, time_ns=ns) for ns, _, f in rows]


# Bits --------------------------------------------------------------------------------------------


@given(drawn_signals(), st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=4))
def test_every_signal_is_read_as_cantools_reads_it(signal: Signal, contents: list[bytes]) -> None:
    message = Message(1, "m", 8, [signal])
    found = raw_of(signal, np.frombuffer(b"".join(contents), np.uint8).reshape(-1, 8))
    expected: list[Any] = [message.decode(content) for content in contents]
    assert found.tolist() == [values["s"] for values in expected]


@pytest.mark.parametrize("length", [32, 64])
@pytest.mark.parametrize("order", ["little_endian", "big_endian"])
def test_floats_are_read_as_cantools_reads_them(length: int, order: str) -> None:
    start = 0 if order == "little_endian" else 7
    from cantools.database.conversion import BaseConversion

    signal = Signal("s", start, length, byte_order=order,  # type: ignore[arg-type]
                    conversion=BaseConversion.factory(is_float=True))  # fmt: skip
    message = Message(1, "m", 8, [signal])
    data = message.encode({"s": -12.625})
    found = raw_of(signal, np.frombuffer(data, np.uint8).reshape(1, 8))
    assert found.tolist() == [-12.625]


@given(st.binary(min_size=8, max_size=8), st.integers(0, 0xFFFF))
def test_the_crc_of_many_frames_is_that_of_each(data: bytes, data_id: int) -> None:
    right = bytes([crc(data, data_id)]) + data[1:]
    both = np.frombuffer(right + data, np.uint8).reshape(2, 8)
    assert is_crc_right(both, data_id).tolist() == [True, data[0] == right[0]]


# Tables ------------------------------------------------------------------------------------------


def test_every_value_of_a_drive_is_that_of_cantools(drive: list[TraceRow]) -> None:
    databases = load_databases()
    decoded = decode(logged(drive), databases)
    assert not len(decoded.others) and not decoded.wrong_lengths and not decoded.unknown
    assert sum(len(table.rows) for table in decoded.tables.values()) == len(drive)
    for name, table in decoded.tables.items():
        message = databases.named(name)
        for place, row in enumerate(table.rows.tolist()):
            expected: Any = message.decode(drive[row][2].data, decode_choices=False)
            for signal, values in table.values.items():
                value = values[place]
                is_none = name_of(table, signal, place) == "not_available"
                assert math.isnan(value) if is_none else value == expected[signal]


def name_of(table: Any, signal: str, place: int) -> str:
    return str(table.names[signal].all[place]) if signal in table.names else ""


def test_rows_keep_the_order_and_numbers_have_their_names(drive: list[TraceRow]) -> None:
    table = decode(logged(drive), load_databases()).tables["SUPERVISOR_STATE"]
    times = [ns for ns, _, f in drive if f.can_id == 0x181]
    assert table.frames.time_ns.tolist() == times
    assert table.values["mode"].dtype.kind in "iu"
    modes = [Mode(int(number)).name for number in table.values["mode"]]
    assert modes == table.names["mode"].all.tolist() and set(modes) == {"INIT", "MANUAL"}


def test_what_a_receiver_would_say_is_in_the_table() -> None:
    spec = SPEC_OF_NAME["STEER_STATUS"]
    status = SteerStatus(steering_wheel_angle_rad=1.0, applied_steering_wheel_angle_rad=math.nan)
    sent = [encode(spec, status, number) for number in (0, 1, 2, 2, 4, 9)]
    broken = Frame(spec.can_id, bytes([sent[0].data[0] ^ 1]) + sent[0].data[1:])
    frames = [frame(f.can_id, f.data) for f in (*sent, broken)]
    protection = decode(frames, load_databases()).tables["STEER_STATUS"].protection
    assert protection is not None
    assert protection.counter.tolist() == [0, 1, 2, 2, 4, 9, 0]
    assert protection.verdict.all.tolist() == [
        "wrong_sequence", "ok", "ok", "repeated", "lost_one", "wrong_sequence", "error",
    ]
    assert protection.is_crc_right.tolist() == [True] * 6 + [False]


def test_counters_go_on_from_chunk_to_chunk_and_channel_by_channel() -> None:
    spec = SPEC_OF_NAME["STEER_STATUS"]
    status = SteerStatus(steering_wheel_angle_rad=1.0, applied_steering_wheel_angle_rad=0.0)
    sent = [encode(spec, status, number) for number in range(4)]
    decoder, names = Decoder(load_databases()), ChannelNames()
    verdicts = []
    for f in sent:
        chunk = [frame(f.can_id, f.data, channel=channel) for channel in ("can0", "can1")]
        table = decoder.decode(as_columns(chunk, [1, 2], names)).tables["STEER_STATUS"]
        assert table.protection is not None
        verdicts += table.protection.verdict.all.tolist()
    assert verdicts == ["wrong_sequence"] * 2 + ["ok"] * 6


def test_a_multiplexed_signal_is_there_where_its_page_is(tmp_path: Path) -> None:
    databases = databases_of(MUX, tmp_path)
    message = databases.named("Level")
    frames = [
        frame(100, message.encode({"page": 0, "depth": -1.25, "count": 3})),
        frame(100, message.encode({"page": 1, "heat": 20.5, "count": 5})),
        frame(100, message.encode({"page": 1, "heat": "cold", "count": 5})),
        frame(100, message.encode({"page": 1, "heat": "broken", "count": 5}, strict=False)),
        frame(100, bytes([7]) + bytes(7)),
    ]
    table = decode(frames, databases).tables["Level"]
    nan = pytest.approx(math.nan, nan_ok=True)
    assert table.values["depth"].tolist() == [pytest.approx(-1.25), nan, nan, nan, nan]
    assert table.values["heat"].tolist() == [nan, 20.5, 0.5, nan, nan]
    assert table.names["heat"].all.tolist() == ["", "", "cold", "broken", ""]
    assert table.values["count"].tolist() == [3, 5, 5, 5, 1]
    assert table.values["count"].dtype == np.int64


def test_nothing_is_dropped(tmp_path: Path) -> None:
    databases = databases_of(FOREIGN, tmp_path)
    frames = [
        frame(100, bytes(8)),
        frame(100, bytes(7)),
        frame(0x7FF, b"\x01"),
        frame(100, b"", flags=FrameFlag.REMOTE),
        frame(102, bytes(2), flags=FrameFlag.EXTENDED),
        frame(0x40, bytes(8), flags=FrameFlag.ERROR),
        frame(101, b""),
    ]
    decoded = decode(frames, databases)
    assert {name: table.rows.tolist() for name, table in decoded.tables.items()} == {
        "Level": [0], "Wide": [4], "Empty": [6],
    }
    assert decoded.others.tolist() == [1, 2, 3, 5]
    assert decoded.wrong_lengths == {"Level": 1} and decoded.unknown == 1
    lines = lines_of(decoded)
    assert [line.split()[2] for line in lines] == [
        "064#0000000000000000", "064#00000000000000", "7FF#01", "064#R", "00000066#0000",
        "20000040#0000000000000000", "065#",
    ]
    assert lines[2].split()[3:] == [] and lines[6].split()[3:] == ["Empty"]
    assert len(lines_of(decoded, with_others=False)) == 3


def test_an_empty_log_has_no_tables() -> None:
    decoded = decode([], load_databases())
    assert decoded.tables == {} and lines_of(decoded) == []


def test_only_what_is_wanted_is_read(drive: list[TraceRow]) -> None:
    databases = load_databases()
    only = [databases.named("SteerStatus")]
    decoded = decode(
        logged(drive), databases, only=only, signals=["applied_steering_wheel_angle_rad"]
    )
    assert list(decoded.tables) == ["STEER_STATUS"]
    assert list(decoded.tables["STEER_STATUS"].values) == ["applied_steering_wheel_angle_rad"]


# Lines and files ---------------------------------------------------------------------------------


def test_lines_tell_message_verdict_units_and_names(drive: list[TraceRow]) -> None:
    lines = lines_of(decode(logged(drive), load_databases()))
    assert len(lines) == len(drive)
    (_, _, first), line = drive[-1], lines[-1]
    assert line.startswith(f"({drive[-1][0] // 1000 / 1e6:017.6f}) can0 {first.can_id:03X}#")
    state = next(line for line in reversed(lines) if "SUPERVISOR_STATE" in line)
    assert " ok)  mode=MANUAL, " in state and "crc=" not in state and "=85 ms" in state
    steer = next(line for line in reversed(lines) if "STEER_STATUS" in line)
    assert "applied_steering_wheel_angle_rad=not_available" in steer
    assert " rad, applied" in steer


def test_csv_and_parquet_hold_every_row(drive: list[TraceRow], tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import csv, parquet

    decoded = decode(logged(drive), load_databases())
    tables = {"csv": write_csv(decoded, tmp_path), "parquet": write_parquet(decoded, tmp_path)}
    for kind, paths in tables.items():
        assert [path.name for path in paths] == sorted(f"{n}.{kind}" for n in decoded.tables)
        for path in paths:
            table = decoded.tables[path.stem]
            read = csv.read_csv(path) if kind == "csv" else parquet.read_table(path)
            assert isinstance(read, pyarrow.Table) and read.num_rows == len(table.rows)
            assert read.column_names == list(columns_of(table))
            assert read["time_ns"].to_pylist() == table.frames.time_ns.tolist()
    status = parquet.read_table(tmp_path / "STEER_STATUS.parquet")
    field = status.schema.field("steering_wheel_angle_rad")
    assert field.metadata == {b"unit": b"rad"}
    assert status["applied_steering_wheel_angle_rad"].null_count == status.num_rows


def test_a_log_becomes_data_frames(drive: list[TraceRow], tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text("".join(f"{line}\n" for line in lines_of(decode(logged(drive), Databases()))))
    frames = decode_log(path)
    state = frames["SUPERVISOR_STATE"]
    assert state.index.name == "time_s"
    times = [ns // 1000 / 1e6 for ns, _, f in drive if f.can_id == 0x181]
    assert state.index.tolist() == pytest.approx(times)
    assert state["mode_name"].iloc[-1] == "MANUAL" and int(state["mode"].iloc[-1]) == Mode.MANUAL
    assert state["verdict"].iloc[1:].eq("ok").all()
    assert frames["STEER_STATUS"]["applied_steering_wheel_angle_rad"].isna().all()
    assert sum(len(table) for table in frames.values()) == len(drive)
