"""Every kind of frame goes into every format and comes back, or the loss is named."""

from __future__ import annotations

import json
import resource
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise, product
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from canbus.heard import (
    CLASSICAL,
    ERROR_FLAG,
    EXTENDED_FLAG,
    EXTENDED_ID_MAX,
    REMOTE_FLAG,
    Heard,
)
from telemetry.databases import load_databases
from telemetry.decode.tables import Decoder
from telemetry.logs.reading import Log
from telemetry.record.channels import ChannelNumbers
from telemetry.record.convert import convert_log
from telemetry.record.formats import FORMATS, FormatError, Setting, Writer, format_of
from telemetry.record.log_file import LogFile, LogFullError
from telemetry.record.recorder import BATCH_NS, Recorder, RecordingError, Rotation

START_NS = 1_700_000_000_123_456_000
US, MS, S = 1_000, 1_000_000, 1_000_000_000
DATABASES = load_databases()
STEERING = bytes.fromhex("B83800004000A0FF")
FRAMES = [
    Heard(START_NS, "vcan0", 0x182, STEERING, 8),
    Heard(START_NS + US, "can1", 0x1ABCDE01 | EXTENDED_FLAG, b"\1\2", 2, CLASSICAL, True),
    Heard(START_NS + 2 * US, "can1", 0x123 | REMOTE_FLAG, b"", 5),
    Heard(START_NS + 3 * US, "can1", 0x1 | EXTENDED_FLAG | REMOTE_FLAG, b"", 0, CLASSICAL, True),
    Heard(START_NS + 4 * US, "vcan0", 0x123, bytes(range(12)), 12, 3),
    Heard(START_NS + 5 * US, "vcan0", 0x123 | EXTENDED_FLAG, bytes(64), 64, 0, True),
    Heard(START_NS + 6 * US, "vcan0", 0x123, b"", 0, 2),
    Heard(START_NS + 7 * US, "vcan0", ERROR_FLAG | 0x88, bytes(range(8)), 8),
    Heard(START_NS + 8 * US, "vcan0", ERROR_FLAG | 0x4, bytes(8), 8, CLASSICAL, True),
    Heard(START_NS + S, "vcan0", 0x7FF, b"", 0),
]
EVERY_FORMAT = pytest.mark.parametrize("ending", list(FORMATS))
LIVE = pytest.mark.parametrize("ending", [end for end, kind in FORMATS.items() if kind.is_live])
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)


def setting() -> Setting:
    return Setting(databases=DATABASES, numbers=ChannelNumbers())


def opened(path: Path, numbers: ChannelNumbers | None = None) -> tuple[LogFile, Writer]:
    file = LogFile(path)
    given_setting = Setting(databases=DATABASES, numbers=numbers or ChannelNumbers())
    return file, format_of(path).open(file, given_setting)


def write(path: Path, frames: Sequence[Heard]) -> Path:
    _, writer = opened(path)
    writer.write(frames[:4])
    writer.write(frames[4:])
    writer.close()
    return path


def heard_of(path: Path) -> list[Heard]:
    return [frame.heard() for frame in Log(path).frames()]


def expected(frames: Sequence[Heard], *endings: str) -> list[Heard]:
    """What is left of frames behind some formats, written by hand: what the documents promise."""
    for ending in endings:
        kept = []
        for item in frames:
            if ending != ".mcap":
                item = item._replace(time_ns=item.time_ns // US * US)
            if ending in (".asc", ".blf", ".mf4"):
                channels = list(dict.fromkeys(frame.channel for frame in frames))
                item = item._replace(channel=str(channels.index(item.channel)))
            if item.is_error and ending == ".asc":
                item = item._replace(word=ERROR_FLAG, data=b"", length=0, is_sent=False)
            if item.is_error and ending == ".blf":
                item = item._replace(is_sent=False)
            kept.append(item)
        if ending == ".mf4":
            kept.sort(key=lambda item: (item.time_ns, item.is_remote, item.is_error))
        frames = kept
    return list(frames)


@pytest.mark.parametrize(("first", "second"), list(product(FORMATS, FORMATS)))
def test_every_kind_of_frame_goes_from_each_format_into_each(
    first: str, second: str, tmp_path: Path
) -> None:
    a, b = write(tmp_path / f"a{first}", FRAMES), tmp_path / f"b{second}"
    assert heard_of(a) == expected(FRAMES, first)
    done = convert_log(a, b, format_of(b), setting())
    assert done.frames == len(FRAMES)
    assert heard_of(b) == expected(FRAMES, first, second)
    is_changed = expected(FRAMES, first, second) != expected(FRAMES, first)
    assert bool(done.losses) == is_changed or second in (".blf", ".asc")


@st.composite
def frames_of_a_bus(draw: st.DrawFn) -> list[Heard]:
    time_ns = draw(st.sampled_from([0, START_NS // S * S])) + draw(st.integers(0, S - 1))
    frames = []
    for _ in range(draw(st.integers(1, 12))):
        time_ns += draw(st.integers(0, 10**10))
        kind = draw(st.sampled_from(["data", "fd", "remote", "error"]))
        flags = CLASSICAL
        is_extended = draw(st.booleans())
        word = draw(st.integers(0, EXTENDED_ID_MAX if is_extended else 0x7FF))
        word |= EXTENDED_FLAG * is_extended
        length = draw(st.integers(0, 8))
        if kind == "fd":
            flags, length = draw(st.integers(0, 3)), draw(st.sampled_from(FD_LENGTHS))
        if kind == "error":
            word = ERROR_FLAG | word & EXTENDED_ID_MAX
        data = draw(st.binary(min_size=length, max_size=length))
        if kind == "remote":
            word, data = word | REMOTE_FLAG, b""
        channel = draw(st.sampled_from(["can0", "vcan1"]))
        frames.append(Heard(time_ns, channel, word, data, length, flags, draw(st.booleans())))
    return frames


@EVERY_FORMAT
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(frames=frames_of_a_bus())
def test_any_frames_come_back(ending: str, frames: list[Heard], tmp_path: Path) -> None:
    path = tmp_path / f"x{ending}"
    path.unlink(missing_ok=True)
    assert heard_of(write(path, frames)) == expected(frames, ending)


def test_each_loss_is_named_with_its_number(tmp_path: Path) -> None:
    early = FRAMES[0]._replace(time_ns=START_NS - S + 7)
    log = write(tmp_path / "a.mcap", [*FRAMES, early])
    said = {
        ending: convert_log(log, tmp_path / f"b{ending}", kind, setting()).losses
        for ending, kind in FORMATS.items()
    }
    cut = "1 frames: their times are cut to the microsecond in {}"
    begins = "1 frames are from before the first, where {} begins to count"
    numbers = "{} has numbers for channels: vcan0 is 0, can1 is 1"
    assert said == {
        ".log": [cut.format("candump")],
        ".asc": [
            cut.format("ASC"), begins.format("ASC"),
            "2 error frames lose all but their time and channel in ASC", numbers.format("ASC"),
        ],
        ".blf": [
            cut.format("BLF"), begins.format("BLF"), "2 error frames lose their direction in BLF",
            numbers.format("BLF"),
        ],
        ".mcap": [],
        ".mf4": [
            cut.format("MF4"),
            "1 frames change their place: MF4 has data, error and remote frames apart, by time",
            numbers.format("MF4"),
        ],
    }  # fmt: skip


def test_names_that_are_numbers_stay_and_no_two_channels_become_one() -> None:
    numbers = ChannelNumbers()
    assert [numbers.number(name) for name in ("3", "can0", "0", "007", "3", "can0")] == [
        3, 0, 1, 2, 3, 0,
    ]  # fmt: skip
    assert numbers.renamed() == ["can0 is 0", "0 is 1", "007 is 2"]


def test_foxglove_finds_a_channel_and_a_schema_for_each_message(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", FRAMES)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = list(reader.iter_messages())
        summary = reader.get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == len(found) == len(FRAMES) + 1
    topics = {channel.topic for channel in summary.channels.values()}
    assert topics == {"/vcan0/raw", "/can1/raw", "/vcan0/STEER_STATUS"}
    assert all(a[2].log_time <= b[2].log_time for a, b in pairwise(found))
    schema, channel, message = next(m for m in found if m[1].topic.endswith("STEER_STATUS"))
    assert schema is not None and channel.message_encoding == "json"
    assert (schema.name, schema.encoding) == ("STEER_STATUS", "jsonschema")
    properties = json.loads(schema.data)["properties"]
    values = json.loads(message.data)
    assert set(values) <= set(properties) and message.log_time == START_NS
    kinds = {"integer": (int,), "number": (int, float), "string": (str,)}
    assert all(type(value) in kinds[properties[key]["type"]] for key, value in values.items())
    (decoded,) = Decoder(DATABASES).decode(Log(path).columns().take(slice(0, 1))).tables.values()
    for name, column in decoded.values.items():
        assert values.get(name, float("nan")) == pytest.approx(column[0], nan_ok=True), name
    for name, names in decoded.names.items():
        assert values.get(f"{name}_name", "") == names.all[0]
    unit = next(s.unit for s in decoded.message.signals if s.name == "steering_wheel_angle_rad")
    assert unit and properties["steering_wheel_angle_rad"]["description"].startswith(unit)


@LIVE
def test_what_was_written_is_readable_though_the_file_was_never_closed(
    ending: str, tmp_path: Path
) -> None:
    path = tmp_path / f"a{ending}"
    _, writer = opened(path)
    writer.write(FRAMES[:6])
    writer.write(FRAMES[6:])
    whole = path.read_bytes()
    log = Log(path)
    assert [frame.heard() for frame in log.frames()] == expected(FRAMES, ending)
    writer.close()
    (tmp_path / "b").write_bytes(whole[: len(whole) - 5])
    assert heard_of(tmp_path / "b")[:6] == expected(FRAMES, ending)[:6]


def test_an_mcap_that_was_cut_off_says_so(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write(path, FRAMES)
    assert Log(path).problems.lines() == []
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 5])
    log = Log(path)
    assert len(list(log.frames())) < len(FRAMES)
    assert any("cut off" in line for line in log.problems.lines())


def test_foreign_mcap_and_broken_mf4_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    " + bytes(100))
    log = Log(tmp_path / "a.mf4")
    assert list(log.frames()) == [] and "reading ends here" in log.problems.lines()[0]
    path = write(tmp_path / "b.mcap", FRAMES)
    path.write_bytes(path.read_bytes().replace(b"can-by-wire", b"something e"))
    assert len(heard_of(path)) == len(FRAMES)  # whoever wrote it: the schema's name decides


@contextmanager
def room_for(size_bytes: int) -> Iterator[None]:
    """Files cannot grow beyond that: the error of a full disk at a place that is known."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def traffic(count: int) -> list[Heard]:
    return [
        Heard(START_NS + n * MS, "can0", 0x182, n.to_bytes(8, "little"), 8) for n in range(count)
    ]


@LIVE
def test_a_full_disk_ends_the_recording_with_a_whole_file(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    frames = traffic(4_000)
    recorder = Recorder(path, format_of(path), setting(), Rotation(), 0)
    with room_for(20_000), pytest.raises(RecordingError) as error:
        for n in range(0, len(frames), 100):
            recorder.add(frames[n : n + 100], (n + 1) * BATCH_NS)
    assert "File too large: the recording ends here" in str(error.value)
    log = Log(path)
    kept = [frame.heard() for frame in log.frames()]
    assert 100 <= len(kept) == recorder.frames < len(frames)
    assert kept == expected(frames, ending)[: len(kept)]
    assert [line for line in log.problems.lines() if "events of an ASC" not in line] == []
    assert path.stat().st_size <= 20_000
    if ending == ".mcap":
        with path.open("rb") as file:
            assert len(list(make_reader(file).iter_messages(topics="/can0/raw"))) == len(kept)


def test_a_failed_write_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    file = LogFile(tmp_path / "a")
    file.write(b"12345")
    file.commit()
    file.write(b"x" * 100)
    with room_for(50), pytest.raises(LogFullError):
        file.commit()
    file.write(b"nothing more")
    file.seek(1)
    file.write(b"X")
    file.close()
    assert (tmp_path / "a").read_bytes() == b"1X345"


@LIVE
def test_rotation_by_size_keeps_every_frame_in_order(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    frames = traffic(2_000)
    rotation = Rotation(size_bytes=10_000)
    recorder = Recorder(path, format_of(path), setting(), rotation, 0)
    for n in range(0, len(frames), 100):
        recorder.add(frames[n : n + 100], (n + 1) * BATCH_NS)
    recorder.close(len(frames) * BATCH_NS)
    assert recorder.frames == len(frames)
    assert [file.name for file in recorder.paths[:2]] == [f"a-0001{ending}", f"a-0002{ending}"]
    found = [item for file in recorder.paths for item in heard_of(file)]
    assert found == expected(frames, ending)
    assert not path.exists()


def test_rotation_by_time_keeps_the_newest_files(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    rotation = Rotation(age_ns=2 * S, files_max=2)
    recorder = Recorder(path, format_of(path), setting(), rotation, 0)
    for n, item in enumerate(traffic(10), 1):
        recorder.add([item], n * S)
    recorder.close(11 * S)
    assert [file.name for file in recorder.paths] == ["a-0005.log", "a-0006.log"]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a-0005.log", "a-0006.log"]
    assert [len(heard_of(file)) for file in recorder.paths] == [2, 0]


def test_a_frame_waits_no_longer_than_a_batch(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    recorder = Recorder(path, format_of(path), setting(), Rotation(), 0)
    recorder.add(FRAMES[:1], BATCH_NS - 1)
    assert path.stat().st_size == 0
    recorder.add([], BATCH_NS)
    assert len(heard_of(path)) == 1
    recorder.close(BATCH_NS)


def test_no_file_is_written_over(tmp_path: Path) -> None:
    path = write(tmp_path / "a.log", FRAMES)
    with pytest.raises(RecordingError, match="exists: name another"):
        Recorder(path, format_of(path), setting(), Rotation(), 0)
    with pytest.raises(RecordingError, match="exists: name another"):
        convert_log(path, path, format_of(path), setting())
    with pytest.raises(RecordingError, match="cannot be written: No such file"):
        convert_log(path, tmp_path / "no" / "b.log", format_of(path), setting())
    assert heard_of(path) == expected(FRAMES, ".log")


def test_an_ending_that_is_no_format_is_told_with_those_that_are() -> None:
    with pytest.raises(FormatError, match=r"ending says the format: .log, .asc, .blf, .mcap, .mf4"):
        format_of(Path("drive.trc"))
    with pytest.raises(FormatError, match=r"would lose everything in a crash: record .log"):
        format_of(Path("drive.mf4"), is_live=True)
    assert format_of(Path("DRIVE.MCAP")).name == "MCAP"
