"""The oracle's own decoding beside cantools and the nodes' rules: one DBC, the same verdicts."""

from __future__ import annotations

import math
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canbus.frame import Frame, FrameKind
from canbus.node import NODE_IDS
from dbc import messages
from dbc.database import VEHICLE_DBC, load
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import SPECS
from dbc.protection import USABLE, AliveCheck, protect
from oracle import words
from oracle.decode import CounterRule, channels, node_names
from tests.dbc.dbc_signals import PROTECTION, not_available

PROTECTED = sorted(name for name, spec in SPEC_OF_NAME.items() if spec.data_id is not None)


def random_frame(name: str, random: Random, counter: int) -> Frame:
    """Random bits, rightly protected."""
    spec = SPEC_OF_NAME[name]
    data = bytearray(random.randbytes(spec.length))
    if spec.data_id is None:
        return Frame(spec.can_id, bytes(data))
    data[1] &= 0xF0
    return Frame(spec.can_id, protect(data, spec.data_id, counter))


@pytest.mark.parametrize("name", sorted(SPEC_OF_NAME))
def test_values_are_those_of_cantools(name: str) -> None:
    random, channel = Random(name), channels()[name]
    message = load(VEHICLE_DBC).get_message_by_name(name)
    for number in range(200):
        frame = random_frame(name, random, number % 15)
        values = channel.hear(number, str(channel.sender), frame).values
        raw = message.decode(frame.data, decode_choices=False, scaling=False)
        scaled = message.decode(frame.data, decode_choices=False)
        assert isinstance(raw, dict) and isinstance(scaled, dict)
        for signal in message.signals:
            if signal.name in PROTECTION:
                continue
            is_there = raw[signal.name] != not_available(signal)
            expected = scaled[signal.name] if is_there else math.nan
            assert values[signal.name] == pytest.approx(expected, abs=1e-9, nan_ok=True)


@given(st.lists(st.integers(min_value=0, max_value=14), max_size=60))
def test_the_counter_rule_agrees_with_the_nodes_table(counters: list[int]) -> None:
    ours, theirs = CounterRule(), AliveCheck()
    for counter in counters:
        assert ours.accepts(counter) == (theirs.judge(counter) in USABLE)


@pytest.mark.parametrize("name", PROTECTED)
def test_every_single_wrong_bit_is_seen(name: str) -> None:
    channel = channels()[name]
    frame = random_frame(name, Random(name), 3)
    assert channel.is_intact(frame.data)
    for bit in range(64):
        wrong = bytearray(frame.data)
        wrong[bit // 8] ^= 1 << bit % 8
        assert not channel.is_intact(bytes(wrong))


def test_faults_are_named() -> None:
    channel = channels()["STEER_COMMAND"]
    random = Random(1)
    frames = [random_frame("STEER_COMMAND", random, counter) for counter in (0, 1, 1, 5, 6)]
    faults = [channel.hear(0, "Gateway", frame).fault for frame in frames]
    assert faults == ["counter", "", "counter", "counter", ""]
    data = frames[0].data
    assert channel.hear(0, "Gateway", Frame(0x202, data[:7])).fault == "length"
    assert channel.hear(0, "Gateway", Frame(0x202, data + b"\x00")).fault == "length"
    assert channel.hear(0, "Gateway", Frame(0x202, bytes(8))).fault == "crc"
    assert channel.hear(0, "Gateway", Frame(0x202, b"", FrameKind.REMOTE)).fault == "kind"
    assert channel.hear(0, "stranger", Frame(0x202, bytes(8))).fault == "crc"


def test_a_sequence_is_followed_through_a_strangers_frames() -> None:
    channel, random = channels()["STEER_COMMAND"], Random(2)

    def hear(sender: str, counter: int) -> tuple[bool, str]:
        message = channel.hear(0, sender, random_frame("STEER_COMMAND", random, counter))
        return message.is_genuine, message.fault

    assert hear("Gateway", 0) == (True, "counter")
    assert hear("Gateway", 1) == (True, "")
    assert hear("stranger", 9) == (False, "counter")
    assert hear("stranger", 10) == (False, "")
    assert hear("Gateway", 2) == (True, "")  # by the true sender's own sequence


def test_only_what_differs_is_news() -> None:
    channel, random = channels()["SAFETY_VERDICT"], Random(3)
    first = random_frame("SAFETY_VERDICT", random, 0).data
    data_id = channel.data_id
    assert data_id is not None

    def again(counter: int) -> Frame:
        data = bytearray(first)
        data[1] &= 0xF0
        return Frame(channel.can_id, protect(data, data_id, counter))

    news = []
    for counter, sender in ((0, "SafetyMonitor"), (1, "SafetyMonitor"), (2, "SafetyMonitor"),
                            (3, "stranger"), (4, "SafetyMonitor"), (5, "SafetyMonitor")):
        channel.hear(counter, sender, again(counter))
        news.append(channel.is_news)
    assert news == [True, True, False, True, True, False]


@pytest.mark.parametrize(
    "name", ["Mode", "NodeState", "Verdict", "Request", "HeartbeatState", "NmtCommand"]
)
def test_words_are_those_of_the_dbc(name: str) -> None:
    ours: Any = getattr(words, name)
    theirs: Any = getattr(messages, name)
    assert {w.name: w.value for w in ours} == {w.name: w.value for w in theirs}


def test_messages_and_nodes_are_those_of_the_dbc() -> None:
    assert node_names() == set(NODE_IDS)
    assert {channel.can_id for channel in channels().values()} == set(SPECS)
    for name, channel in channels().items():
        spec = SPEC_OF_NAME[name]
        assert (channel.sender, channel.timeout_ns) == (spec.sender, spec.timeout_ns)
        assert (channel.data_id, channel.length) == (spec.data_id, spec.length)
    assert set(words.HEARTBEATS.values()) == set(NODE_IDS)
    assert all(channels()[name].sender == node for name, node in words.HEARTBEATS.items())
    assert all(name in SPEC_OF_NAME for name in words.BRAKE_FRAMES)
