"""`dbw monitor`'s lines: columns, times, meaning, verdicts, and which frames are shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from canbus.heard import ERROR_CLASSES_ALL, EXTENDED_FLAG, Heard
from dbc.messages import SPECS
from telemetry.databases import load_databases
from telemetry.monitor.filters import FilterError, Source
from telemetry.monitor.known import Catalogue, SignalValue
from telemetry.monitor.meaning import Interpreter
from telemetry.monitor.plain import LineWriter, Stamp, StampWriter
from telemetry.monitor.selection import Selection, select
from telemetry.monitor.style import BAD, GOOD, coloured, plain_text
from tests.telemetry.monitored import FOREIGN_DBC, MS, S, heard, interpreter, steering


def writer(
    *, stamp: Stamp = Stamp.NONE, selection: Selection | None = None,
    names: Interpreter | None = None, with_meaning: bool = True, as_log: bool = False,
) -> LineWriter:  # fmt: skip
    return LineWriter(
        interpreter=names or interpreter(),
        selection=selection or Selection(),
        stamps=StampWriter(stamp, lambda seconds: f"day+{seconds}"),
        with_meaning=with_meaning,
        as_log=as_log,
    )


def lines(frames: list[Heard], using: LineWriter) -> list[str]:
    texts = [using.text(frame) for frame in frames]
    return [text for text in texts if text is not None]


def foreign(tmp_path: Path, *, canopen: bool | None = None) -> Interpreter:
    path = tmp_path / "foreign.dbc"
    path.write_text(FOREIGN_DBC, encoding="utf-8")
    return Interpreter(Catalogue(load_databases([path])), canopen=canopen)


def test_a_message_has_candumps_columns_verdict_values_and_units() -> None:
    frame = steering(0.5, counter=3)
    assert lines([frame], writer()) == [
        f"  can0  182   [8]  {frame.data.hex(' ').upper()}    STEER_STATUS (3 first)  "
        "steering_wheel_angle_rad=0.5 rad, applied_steering_wheel_angle_rad=n/a"
    ]


@pytest.mark.parametrize("can_id", SPECS)
def test_every_message_of_ours_is_read_and_shows_all_its_signals(can_id: int) -> None:
    spec = SPECS[can_id]
    known = Catalogue().find("can0", can_id)
    assert known is not None and known.name == spec.name and known.signals == tuple(spec.units)
    content = known.read(bytes(spec.length))
    assert [value.name for value in content.values] == list(spec.units) or content.fault


def test_the_verdict_follows_counter_and_crc() -> None:
    using = writer()
    frames = [steering(counter=n) for n in (3, 4, 4, 6, 10, 11)]
    broken = frames[5]._replace(data=b"\xff" + frames[5].data[1:])
    short = frames[5]._replace(data=bytes(3), length=3)
    verdicts = [
        line.partition("STEER_STATUS")[2].split("  ")[0].strip()
        for line in lines([*frames, broken, short], using)
    ]
    assert verdicts == [
        "(3 first)", "(4 ok)", "(4 repeated)", "(6 one lost)", "(10 out of sequence)", "(11 ok)",
        "(CRC wrong)", "(CRC wrong)",
    ]  # fmt: skip


def test_a_wrong_crc_is_red_and_shows_no_values() -> None:
    frame = steering()._replace(data=bytes(8))
    spans = writer().line(frame)
    assert spans is not None
    assert [s.text for s in spans if s.style is BAD] == ["STEER_STATUS", " (CRC wrong)"]
    assert "angle" not in plain_text(spans)


def test_colours_are_the_terminals_codes_around_the_same_text() -> None:
    using = writer()
    using.line(steering(counter=1))
    spans = using.line(steering(counter=2))
    assert spans is not None
    assert [s.text for s in spans if s.style is GOOD] == [" (2 ok)"]
    text = coloured(spans)
    assert "\x1b[32m (2 ok)\x1b[0m" in text and plain_text(spans) != text


@pytest.mark.parametrize(
    ("stamp", "expected"),
    [
        (Stamp.NONE, ["", ""]),
        (Stamp.ABSOLUTE, [" (0000000012.500000)", " (0000000012.501234)"]),
        (Stamp.DELTA, [" (000.000000)", " (000.001234)", " (-000.000234)"]),
        (Stamp.ZERO, [" (000.000000)", " (000.001234)", " (000.001000)"]),
        (Stamp.DATE, [" (day+12.500000)", " (day+12.501234)"]),
    ],
)
def test_times_are_written_as_candump_does(stamp: Stamp, expected: list[str]) -> None:
    times = (12 * S + 500 * MS, 12 * S + 501 * MS + 234_567, 12 * S + 501 * MS)
    found = lines([heard("123#", t) for t in times], writer(stamp=stamp))
    assert [line.partition("  can0")[0] for line in found][: len(expected)] == expected


def test_delta_is_between_frames_that_are_shown() -> None:
    only = Selection(sources=(Source.parse("can0,123:7FF"),))
    frames = [heard("123#", 1 * S), heard("124#", 2 * S), heard("123#", 3 * S)]
    found = lines(frames, writer(stamp=Stamp.DELTA, selection=only))
    assert [line.split()[0] for line in found] == ["(000.000000)", "(002.000000)"]


def test_unknown_frames_are_shown_raw() -> None:
    assert lines([heard("7DF#0201")], writer()) == ["  can0  7DF   [2]  02 01"]


def test_remote_error_and_fd_frames() -> None:
    found = lines(
        [heard("182#R8"), heard("20000040#0000000000000000"), heard("182##1" + "00" * 12)], writer()
    )
    assert found[0].endswith("STEER_STATUS  asks for 8 bytes")
    assert found[1].endswith("20000040   [8]  00 00 00 00 00 00 00 00  ERRORFRAME  BUS-OFF")
    assert "182  [12]  00" in found[2] and "CRC wrong" in found[2]


def test_raw_is_candumps_line_and_no_more() -> None:
    frames = [steering(), heard("20000040#00")]
    found = lines(frames, writer(with_meaning=False))
    assert found[0] == f"  can0  182   [8]  {frames[0].data.hex(' ').upper()}"
    assert found[1] == "  can0  20000040   [1]  00" + " " * 24 + "ERRORFRAME"


def test_the_log_format_is_candumps_and_nothing_else() -> None:
    frame = heard("182#1122", 1_500_000_000)
    assert lines([frame], writer(as_log=True)) == ["(0000000001.500000) can0 182#1122"]


def test_canopens_words_are_shown_beside_the_messages_name() -> None:
    assert lines([heard("702#05")], writer())[0].endswith(
        "STEER_HEARTBEAT  heartbeat of Steering: operational"
    )
    assert lines([heard("711#05")], writer())[0].endswith("  heartbeat of node 17: operational")
    assert lines([heard("191#05")], writer())[0].endswith("  TPDO1 of node 17")


def test_channels_of_different_length_are_aligned() -> None:
    using = writer()
    using.channel_width = 5
    found = lines([heard("123#", channel="can0"), heard("123#", channel="vcan0")], using)
    assert [line.index("123") for line in found] == [9, 9]


def test_a_foreign_dbc_gives_names_units_enums_and_no_more_digits_than_needed(
    tmp_path: Path,
) -> None:
    using = writer(names=foreign(tmp_path))
    found = lines([heard("100#9C0101500A000000"), heard("18FEF1FE#32000000")], using)
    assert found[0].endswith("ENGINE  speed=103 rpm, gear=first, temperature=40 degC")
    assert "ENGINE" in found[0] and found[1].endswith("TRUCK  load=50 %")
    assert lines([heard("100#01")], using)[0].endswith("ENGINE  1 bytes instead of 8")
    assert lines([heard("705#05")], using) == ["  can0  705   [1]  05"]
    told = lines([heard("705#05")], writer(names=foreign(tmp_path, canopen=True)))
    assert told[0].endswith("heartbeat of node 5: operational")


def test_a_message_with_overlapping_signals_is_read_signal_by_signal(tmp_path: Path) -> None:
    path = tmp_path / "overlap.dbc"
    text = FOREIGN_DBC.replace(" SG_ gear : 16|4@1+", " SG_ gear : 2|4@1-")
    path.write_text(text.replace("24|8@1+", "7|16@0+"), encoding="utf-8")
    names = Interpreter(Catalogue(load_databases([path], relaxed=True)))
    found = lines([heard("100#2001000000000000")], writer(names=names))
    # gear: bits 2 to 5 of 0x20 are 0b1000, signed -8; temperature: 0x2001 - 40, first byte first
    assert found[0].endswith("ENGINE  speed=72 rpm, temperature=8153 degC, gear=-8")


def test_our_own_dbc_among_others_keeps_the_fast_reader_and_canopens_words(tmp_path: Path) -> None:
    path = tmp_path / "foreign.dbc"
    path.write_text(FOREIGN_DBC, encoding="utf-8")
    names = Interpreter(Catalogue(load_databases(["vehicle", path])))
    known = names.catalogue.find("can0", 0x182)
    assert known is not None and known.is_own
    assert lines([heard("702#05")], writer(names=names))[0].endswith("operational")
    assert "ENGINE" in lines([heard("100#9C0101500A000000")], writer(names=names))[0]


def test_a_dbc_for_one_channel_is_for_that_channel(tmp_path: Path) -> None:
    path = tmp_path / "foreign.dbc"
    path.write_text(FOREIGN_DBC, encoding="utf-8")
    names = Interpreter(Catalogue(load_databases([f"can1={path}"])))
    found = lines(
        [heard("100#" + "00" * 8, channel="can0"), heard("100#" + "00" * 8, channel="can1")],
        writer(names=names),
    )
    assert ["ENGINE" in line for line in found] == [False, True]


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (12.350000000000001, "ms", "12.35 ms"), (0.1 + 0.2, "", "0.3"), (True, "", "1"),
        (7, "", "7"), ("MANUAL", "", "MANUAL"), (float("nan"), "rad", "n/a"),
        (-0.0005, "", "-0.0005"),
    ],
)  # fmt: skip
def test_values_are_written_short(value: float | str, unit: str, text: str) -> None:
    assert SignalValue("x", value, unit, 0.0).text() == text


@pytest.mark.parametrize(
    ("text", "word", "passes"),
    [
        ("can0", 0x123, True),
        ("can0,123:7FF", 0x123, True),
        ("can0,123:7FF", 0x124, False),
        ("can0,120:7F0", 0x12F, True),
        ("can0,123~7FF", 0x123, False),
        ("can0,123~7FF", 0x124, True),
        ("can0,123:7FF,200:700", 0x2AB, True),
        ("can0,100:700,123~7FF,j", 0x123, False),
        ("can0,100:700,123~7FF,j", 0x124, True),
        ("can0,100:700,123~7FF", 0x200, True),
        ("can0,00000123:DFFFFFFF", 0x123, False),
        ("can0,00000123:DFFFFFFF", 0x123 | EXTENDED_FLAG, True),
        ("can0,123:C00007FF", 0x123 | EXTENDED_FLAG, False),
        ("can0,123:7FF", 0x123 | EXTENDED_FLAG, True),  # the mask leaves the flag out
        ("can0,0~0", 0x123, False),
        ("can0", 0x2000_0040, True),
        ("can0,123:7FF", 0x2000_0040, True),
        ("can0,#0", 0x2000_0040, False),
        ("can0,#40", 0x2000_0040, True),
        ("can0,#4", 0x2000_0040, False),
        ("can0,0~0,#FFFFFFFF", 0x2000_0040, True),
    ],
)
def test_filters_pass_what_candumps_pass(text: str, word: int, passes: bool) -> None:
    assert Source.parse(text).passes(word) is passes


def test_error_classes_are_all_unless_given() -> None:
    assert Source.parse("can0").error_classes == ERROR_CLASSES_ALL
    assert Source.parse("can0,#40").error_classes == 0x40


@pytest.mark.parametrize(
    "text", ["", ",123:7FF", "can0,", "can0,123", "can0,xyz:7FF", "can0,123:7FF,k", "can0,#", "a b"]
)
def test_a_filter_that_is_none_is_refused_with_what_is_allowed(text: str) -> None:
    with pytest.raises(FilterError, match=r"allowed ID:MASK|a channel is wanted"):
        Source.parse(text)


def test_only_named_channels_are_shown_and_any_stands_for_all() -> None:
    frames = [heard("123#", channel="can0"), heard("123#", channel="can1")]
    named = Selection(sources=(Source.parse("can1"),))
    assert len(lines(frames, writer(selection=named))) == 1
    both = Selection(sources=(Source.parse("any,123:7FF"),))
    assert len(lines(frames, writer(selection=both))) == 2


def shown(**names: list[str]) -> list[str]:
    """Names of all messages that a selection passes."""
    catalogue = Catalogue()
    selection = select(catalogue, (), **names)
    return [
        known.name for word, known in catalogue.messages.items()
        if selection.wants("can0", word, known)
    ]  # fmt: skip


def test_names_of_messages_signals_and_nodes_add_up() -> None:
    assert shown(messages=["SteerStatus"]) == ["STEER_STATUS"]
    assert shown(signals=["decision_age_ms"]) == [
        "STEER_COMMAND", "THROTTLE_COMMAND", "BRAKE_COMMAND",
    ]  # fmt: skip
    assert shown(signals=["STEER_COMMAND.decision_age_ms"]) == ["STEER_COMMAND"]
    gateways = [spec.name for spec in SPECS.values() if spec.sender == "Gateway"]
    assert shown(nodes=["gateway"]) == gateways
    assert shown(nodes=["Gateway"], messages=["STEER_STATUS"]) == [
        name for name in (spec.name for spec in SPECS.values())
        if name in (*gateways, "STEER_STATUS")
    ]  # fmt: skip


def test_only_chosen_signals_are_shown_and_unknown_frames_are_not() -> None:
    selection = select(Catalogue(), (), signals=["STEER_STATUS.steering_wheel_angle_rad"])
    found = lines([steering(), heard("7DF#00")], writer(selection=selection))
    assert len(found) == 1 and found[0].endswith("steering_wheel_angle_rad=0.5 rad")


@pytest.mark.parametrize(
    ("names", "error"),
    [
        ({"messages": ["STER_STATUS"]}, "no message 'STER_STATUS': nearest STEER_STATUS"),
        ({"signals": ["steering_wheel_angle"]}, "nearest steering_wheel_angle_rad"),
        ({"signals": ["STEER_STATUS.mode"]}, "no signal 'mode': known are applied_steering"),
        ({"signals": ["STER_STATUS.mode"]}, "no message 'STER_STATUS'"),
        ({"nodes": ["Steerin"]}, "no node 'Steerin': nearest Steering"),
        ({"nodes": ["xyz"]}, "known are BrakeServo, Gateway, SafetyMonitor"),
    ],
)
def test_a_mistyped_name_is_told_the_nearest_ones(names: dict[str, list[str]], error: str) -> None:
    with pytest.raises(FilterError, match=error):
        select(Catalogue(), (), **names)


def test_memory_of_verdicts_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("telemetry.monitor.plain.PROTECTIONS_MAX", 3)
    using = writer()
    for number in range(10):
        using.line(steering()._replace(channel=f"can{number}"))
    assert len(using._protections) <= 3
