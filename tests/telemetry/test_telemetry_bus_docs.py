"""A DBC as a page: where bits lie, what is told of messages, and that the page is whole."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path

import pytest
from cantools.database import load_string
from cantools.database.can import Database, Message, Signal
from hypothesis import given

from canbus.timing import MessageTiming, response_times_ns
from dbc.messages import SPECS, Reason
from gateway.sentences import REASON_TEXT
from telemetry.bus_docs.layout import bits_of, rows_of
from telemetry.bus_docs.model import BusDoc, document
from telemetry.bus_docs.own import parameters, words
from telemetry.bus_docs.page import page_of
from telemetry.databases import load_databases
from tests.telemetry.drawn_signals import drawn_signals

ROOT = Path(__file__).parents[2]

FOREIGN = """VERSION ""
NS_ :
BS_:
BU_: Pump Panel
BO_ 100 Level: 8 Pump
 SG_ page M : 0|4@1+ (1,0) [0|15] "" Panel
 SG_ depth m0 : 15|16@0- (0.01,-5) [-5|5] "m" Panel
 SG_ heat m1 : 8|12@1+ (0.5,0) [0|100] "degC" Panel
BO_ 2147483750 Wide: 2 Panel
 SG_ x : 0|16@1+ (1,0) [0|0] "" Vector__XXX
BO_ 101 Empty: 0 Vector__XXX
CM_ BO_ 100 "<b>tank & pump</b>";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 100 20;
"""


def foreign() -> Database:
    database = load_string(FOREIGN, database_format="dbc")
    assert isinstance(database, Database)
    return database


def own(name: str = "vehicle") -> BusDoc:
    (database,) = load_databases([name]).databases
    return document(database, name)


def bits_that_are_set(message: Message, signal: Signal) -> set[int]:
    """By cantools: which bits a signal of ones sets in a frame of zeros."""
    ones = -1 if signal.is_signed else (1 << signal.length) - 1
    raw = {other.name: 0 for other in message.signals} | {signal.name: ones}
    data = message.encode(raw, scaling=False, strict=False)
    return {8 * byte + bit for byte, value in enumerate(data) for bit in range(8)
            if value >> bit & 1}  # fmt: skip


# Layout ------------------------------------------------------------------------------------------


@given(drawn_signals())
def test_bits_are_where_cantools_puts_them(signal: Signal) -> None:
    message = Message(1, "m", 8, [signal])
    assert set(bits_of(signal)) == bits_that_are_set(message, signal)
    assert len(bits_of(signal)) == signal.length


def test_every_bit_of_a_picture_is_drawn_once_and_every_signal_is_in_it() -> None:
    (database,) = load_databases(["vehicle"]).databases
    for message in database.messages:
        rows = rows_of(message.signals, message.length)
        assert [sum(cell.width for cell in row) for row in rows] == [8] * message.length
        for place, signal in enumerate(message.signals):
            cells = [cell for row in rows for cell in row if cell.signal == place]
            assert sum(cell.width for cell in cells) == signal.length, signal.name
            assert all(cell.text.startswith(signal.name) for cell in cells)


def test_parts_of_a_signal_tell_their_bits() -> None:
    signal = Signal("age", 12, 8)
    texts = [[cell.text for cell in row] for row in rows_of([signal], 3)]
    assert texts == [[""], ["age[3:0]", ""], ["", "age[7:4]"]]


def test_bits_of_two_signals_name_both() -> None:
    rows = rows_of([Signal("a", 0, 4), Signal("b", 2, 4)], 1)
    assert [(cell.text, cell.width) for cell in rows[0]] == [
        ("", 2), ("b[3:2]", 2), ("a[3:2], b[1:0]", 2), ("a[1:0]", 2),
    ]  # fmt: skip


def test_a_signal_that_chooses_gives_a_picture_for_each_choice() -> None:
    message = next(m for m in document(foreign(), "f").messages if m.name == "Level")
    assert [picture.title for picture in message.pictures] == ["page = 0", "page = 1"]
    texts = [{cell.text for row in p.rows for cell in row} for p in message.pictures]
    assert "depth[15:8]" in texts[0] and not any("heat" in text for text in texts[0])
    assert "heat[7:0]" in texts[1] and not any("depth" in text for text in texts[1])


# What is told ------------------------------------------------------------------------------------


def test_every_message_has_its_senders_times_and_protection() -> None:
    by_name = {message.name: message for message in own().messages}
    assert by_name.keys() == {spec.name for spec in SPECS.values()}
    for spec in SPECS.values():
        told = by_name[spec.name]
        assert told.id_text == f"0x{spec.can_id:03X}" and told.length == spec.length
        assert told.senders == ([spec.sender] if spec.sender else [])
        assert (told.cycle_ms or 0) * 1_000_000 == spec.cycle_ns
        assert bool(told.protection) == (spec.data_id is not None)
        assert [row.name for row in told.signals] == [
            signal.name for signal in load_databases().named(spec.name).signals
        ]


def test_response_times_are_those_of_the_analysis() -> None:
    bus = own()
    timings = [
        MessageTiming(can_id=int(m.id_text, 16), length=m.length,
                      period_ns=round((m.cycle_ms or m.gap_ms or 0) * 1e6))
        for m in bus.messages if m.cycle_ms or m.gap_ms
    ]  # fmt: skip
    expected = response_times_ns(timings, bus.bitrate_bps)
    told = {int(m.id_text, 16): m.response_ms for m in bus.messages if m.response_ms is not None}
    assert told == {can_id: ns / 1e6 for can_id, ns in expected.items()}
    assert [load.bitrate_bps for load in bus.loads] == [125_000, 250_000, 500_000, 1_000_000]
    assert 0.2 < bus.loads[2].periodic < bus.loads[2].fastest < 0.6


def test_a_bus_that_is_overloaded_has_no_response_times_and_says_so() -> None:
    (database,) = load_databases(["vehicle"]).databases
    bus = document(database, "slow", bitrate_bps=20_000)
    assert all(message.response_ms is None for message in bus.messages)
    assert "No bound on the response times: bus overloaded at" in bus.timing_note


def test_a_foreign_file_is_told_as_far_as_it_goes() -> None:
    bus = document(foreign(), "foreign", notes=["line 3 left out"])
    by_name = {message.name: message for message in bus.messages}
    assert by_name["Wide"].id_text == "0x00000066" and by_name["Wide"].receivers == []
    assert by_name["Empty"].senders == [] and by_name["Empty"].pictures[0].rows == []
    assert by_name["Level"].cycle_ms == 20 and by_name["Level"].protection == ""
    depth = by_name["Level"].signals[1]
    assert (depth.kind, depth.scale, depth.unit) == ("signed, Motorola", "0.01 x - 5", "m")
    assert depth.condition == "page = 0"
    assert [node.name for node in bus.nodes] == ["Pump", "Panel"]
    assert "line 3 left out" in page_of(bus)


# The page ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["vehicle", "harness"])
def test_the_page_is_whole(name: str) -> None:
    bus = own(name)
    page = page_of(bus, words(), parameters())
    anchors = set(re.findall(r'id="([^"]+)"', page))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= anchors
    assert not re.search(r"(?:src|href)=\"(?!#)|url\(|@import|<script", page)
    for message in bus.messages:
        assert message.anchor in anchors
        for signal in message.signals:
            assert f"<th>{signal.name}</th>" in page


def test_codes_are_told_in_words_and_parameters_with_their_range() -> None:
    page = unescape(page_of(own(), words(), parameters()))
    for reason in Reason:
        assert reason.name in page and REASON_TEXT[reason] in page
    row = next(row for row in parameters()["Steering"] if row.name == "command_timeout_s")
    assert (row.place, row.span, row.unit) == ("0x2100:7", "0.06 to 1.25", "s")
    assert row.access == "read, write in MANUAL"
    assert "Steering: parameters by SDO" in page


def test_what_a_file_says_cannot_become_markup() -> None:
    page = page_of(document(foreign(), "foreign"))
    assert "<b>tank" not in page and "&lt;b&gt;tank &amp; pump&lt;/b&gt;" in page


@pytest.mark.parametrize("name", ["vehicle", "harness"])
def test_the_pages_in_the_docs_are_those_of_the_dbc(name: str) -> None:
    """`make generate` writes them."""
    is_own = name == "vehicle"
    page = page_of(own(name), words(), parameters()) if is_own else page_of(own(name))
    assert (ROOT / "docs" / "bus" / f"{name}.html").read_text(encoding="utf-8") == page
