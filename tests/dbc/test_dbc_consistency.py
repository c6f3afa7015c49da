"""What the DBC files promise: one sender each, CANopen's identifiers, layout, units, times."""

from __future__ import annotations

import re
from configparser import RawConfigParser
from importlib.resources import files

import pytest
from cantools.database.can import Message

from canbus.node import NODE_IDS
from canbus.timing import MessageTiming, bus_load, response_times_ns
from dbc.database import BYTE_COMMANDS_DBC, HARNESS_DBC, VEHICLE_DBC, load
from dbc.generate import attribute
from dbc.messages import SPECS
from dbc.timing import decision_age_limit_ms, planner_period_ms_max
from tests.dbc.dbc_signals import (
    CASE_IDS,
    CASES,
    PROTECTION,
    Case,
    choice_names,
    edge_raws,
    is_valid,
)

VEHICLE = [case for case in CASES if case.dbc == VEHICLE_DBC]
MESSAGES = pytest.mark.parametrize("case", VEHICLE, ids=[case.message.name for case in VEHICLE])
EVERY = pytest.mark.parametrize("case", CASES, ids=CASE_IDS)

# Written a second time by hand.
NODES = {
    "Supervisor": 1, "Steering": 2, "Throttle": 3, "BrakeServo": 4, "SafetyMonitor": 5,
    "Gateway": 6,
}
PREFIX = {
    "Supervisor": "SUPERVISOR", "Steering": "STEER", "Throttle": "THROTTLE", "BrakeServo": "BRAKE",
    "SafetyMonitor": "SAFETY_MONITOR", "Gateway": "GATEWAY",
}
HARNESS_NODES = {"Plant", "Supervisor", "Steering", "Throttle", "BrakeServo", "Operator"}
KNOWN = {
    VEHICLE_DBC: set(NODES),
    HARNESS_DBC: HARNESS_NODES,
    BYTE_COMMANDS_DBC: {"BytePlanner", "ByteAdapter"},
}


def by_hand() -> dict[int, tuple[str, str | None, int, int]]:
    """Identifier: name, sender, cycle and time-out in ms, as the design's table has them."""
    table: dict[int, tuple[str, str | None, int, int]] = {
        0x000: ("NMT", "Supervisor", 0, 0),
        0x001: ("FAILSAFE", None, 0, 0),
        0x181: ("SUPERVISOR_STATE", "Supervisor", 10, 60),
        0x182: ("STEER_STATUS", "Steering", 10, 60),
        0x183: ("THROTTLE_STATUS", "Throttle", 10, 60),
        0x184: ("BRAKE_STATUS", "BrakeServo", 10, 60),
        0x185: ("SAFETY_VERDICT", "SafetyMonitor", 10, 60),
        0x201: ("MODE_REQUEST", "Gateway", 0, 0),
        0x202: ("STEER_COMMAND", "Gateway", 20, 100),
        0x203: ("THROTTLE_COMMAND", "Gateway", 20, 100),
        0x204: ("BRAKE_COMMAND", "Gateway", 20, 100),
        0x282: ("STEER_DRIVER", "Steering", 20, 100),
        0x283: ("THROTTLE_DRIVER", "Throttle", 20, 100),
        0x284: ("BRAKE_DRIVER", "BrakeServo", 20, 100),
    }
    for node, number in NODES.items():
        prefix = PREFIX[node]
        client = None if node == "Supervisor" else "Supervisor"
        table[0x010 + number] = (f"{prefix}_EMERGENCY_BRAKE", node, 0, 0)
        table[0x080 + number] = (f"{prefix}_EMCY", node, 0, 0)
        table[0x580 + number] = (f"{prefix}_SDO_RESPONSE", node, 0, 0)
        table[0x600 + number] = (f"{prefix}_SDO_REQUEST", client, 0, 0)
        table[0x700 + number] = (f"{prefix}_HEARTBEAT", node, 50, 150)
    return table


def test_the_identifiers_are_the_designs() -> None:
    found = {
        spec.can_id: (spec.name, spec.sender, spec.cycle_ns // 10**6, spec.timeout_ns // 10**6)
        for spec in SPECS.values()
    }
    assert found == by_hand()


@EVERY
def test_one_sender_per_identifier(case: Case) -> None:
    senders = [sender for sender in case.message.senders if sender != "Vector__XXX"]
    assert len(senders) <= 1
    assert case.spec.sender == (senders[0] if senders else None)
    nobody = {"FAILSAFE", "SUPERVISOR_SDO_REQUEST"}  # an outside box; an outside tool
    assert bool(senders) or case.message.name in nobody


@pytest.mark.parametrize("dbc", KNOWN)
def test_no_identifier_and_no_name_appears_twice(dbc: str) -> None:
    messages = load(dbc).messages
    assert len({message.frame_id for message in messages}) == len(messages)
    assert len({message.name for message in messages}) == len(messages)
    assert all(message.frame_id <= 0x7FF and not message.is_extended_frame for message in messages)
    assert not any(message.is_fd for message in messages)


@EVERY
def test_senders_and_receivers_are_known_and_nobody_hears_himself(case: Case) -> None:
    known = KNOWN[case.dbc]
    receivers = set(case.message.receivers) - {"Vector__XXX"}
    assert receivers <= known and case.spec.receivers == receivers
    assert {case.spec.sender} <= known | {None}
    assert case.spec.sender not in receivers
    silent = {"FAILSAFE", "SUPERVISOR_SDO_RESPONSE"}  # no signals; read by an outside tool
    assert receivers or case.message.name in silent


def test_the_node_ids_are_the_same_everywhere() -> None:
    assert NODE_IDS == NODES
    assert {node.name for node in load(VEHICLE_DBC).nodes} == set(NODES)
    for node in load(VEHICLE_DBC).nodes:
        assert node.comment is not None and node.comment.startswith(f"Node {NODES[node.name]}.")


EDS = {
    "Supervisor": "supervisor", "Steering": "steering", "Throttle": "throttle",
    "BrakeServo": "brake_servo", "SafetyMonitor": "safety_monitor", "Gateway": "gateway",
}


@pytest.mark.parametrize("node", NODES)
def test_the_eds_files_agree_with_the_identifiers(node: str) -> None:
    eds = RawConfigParser()
    eds.read_string(files("dbc").joinpath("eds", f"{EDS[node]}.eds").read_text("utf-8"))
    number = NODES[node]
    assert int(eds["DeviceInfo"]["ProductNumber"], 0) == number
    assert int(eds["1018sub2"]["DefaultValue"], 0) == number

    def cob_id(section: str) -> int:
        return number + int(eds[section]["DefaultValue"].removeprefix("$NODEID+"), 0)

    assert SPECS[cob_id("1014")].name == f"{PREFIX[node]}_EMCY"
    assert SPECS[cob_id("1200sub1")].name == f"{PREFIX[node]}_SDO_REQUEST"
    assert SPECS[cob_id("1200sub2")].name == f"{PREFIX[node]}_SDO_RESPONSE"
    cycle_ms = SPECS[0x700 + number].cycle_ns // 10**6
    assert int(eds["1017"]["DefaultValue"], 0) == cycle_ms


# Protection --------------------------------------------------------------------------------------

UNPROTECTED = re.compile(r"NMT|FAILSAFE|.*_(EMCY|SDO_RESPONSE|SDO_REQUEST|HEARTBEAT)")


@MESSAGES
def test_everything_but_canopens_own_frames_is_protected(case: Case) -> None:
    is_canopen = UNPROTECTED.fullmatch(case.message.name) is not None
    assert (case.spec.data_id is None) == is_canopen
    assert attribute(case.message, "E2EProfile", "") == ("" if is_canopen else "P01")


@MESSAGES
def test_a_protected_frame_has_the_documented_layout(case: Case) -> None:
    signals = {signal.name: signal for signal in case.message.signals}
    if case.spec.data_id is None:
        assert not set(PROTECTION) & set(signals)
        return
    crc, counter = signals["crc"], signals["alive_counter"]
    assert case.message.length == 8
    assert (crc.start, crc.length) == (0, 8) and (counter.start, counter.length) == (8, 4)
    assert (counter.minimum, counter.maximum) == (0, 14)
    for signal in case.payload:  # bytes 1-3 are reserved: room for freshness and a MAC
        assert signal.start >= 32 and signal.start + signal.length <= 64
    assert sum(signal.length for signal in case.payload) <= 32


def test_the_data_ids_are_unique_and_none_is_zero() -> None:
    data_ids = [spec.data_id for spec in SPECS.values() if spec.data_id is not None]
    assert len(set(data_ids)) == len(data_ids) == 18 and 0 not in data_ids


# Signals -----------------------------------------------------------------------------------------

UNIT_OF_SUFFIX = {
    "rad": "rad", "radps": "rad/s", "mps": "m/s", "ms": "ms", "s": "s", "m": "m", "nm": "N.m",
    "ratio": "1",
}


@EVERY
def test_the_unit_ends_the_signals_name(case: Case) -> None:
    for signal in case.message.signals:
        suffix = re.sub(r"_(max|min)$", "", signal.name).rsplit("_", 1)[-1]
        unit = UNIT_OF_SUFFIX.get(suffix)
        if unit is None:
            assert not signal.unit, f"{signal.name} has a unit that its name does not tell"
        else:
            assert signal.unit == unit, signal.name


@EVERY
def test_signals_lie_within_their_bits_and_apart_from_not_available(case: Case) -> None:
    for signal in case.message.signals:
        assert signal.byte_order == "little_endian" and signal.offset == 0
        assert signal.minimum is not None and signal.maximum is not None
        low = -(1 << signal.length - 1) if signal.is_signed else 0
        high = low + (1 << signal.length) - 1
        assert low * signal.scale <= signal.minimum < signal.maximum <= high * signal.scale
        for raw, name in choice_names(signal).items():
            if name == "not_available":
                assert not signal.minimum <= raw * signal.scale <= signal.maximum
    assert case.payload == [] or edge_raws(case.payload[0])


@EVERY
def test_every_initial_value_is_valid(case: Case) -> None:
    for signal in case.message.signals:
        initial = signal.raw_initial if signal.raw_initial is not None else 0
        assert is_valid(signal, int(initial)), f"{case.message.name}.{signal.name}"


@EVERY
def test_every_message_has_a_comment(case: Case) -> None:
    assert case.message.comment and case.message.comment.strip().endswith(".")
    assert load(case.dbc).nodes and all(node.comment for node in load(case.dbc).nodes)


@MESSAGES
def test_a_message_that_is_judged_by_time_survives_a_loss(case: Case) -> None:
    spec = case.spec
    if not spec.cycle_ns:
        assert spec.timeout_ns == 0
        return
    assert spec.timeout_ns > 2 * spec.cycle_ns
    assert 0 < spec.min_interval_ns < spec.cycle_ns
    if spec.data_id is not None:  # two lost frames, and one more until the sequence is known again
        assert spec.timeout_ns > 4 * spec.cycle_ns


@EVERY
def test_the_attributes_are_the_specifications(case: Case) -> None:
    message: Message = case.message
    assert case.spec.name == message.name and case.spec.length == message.length
    assert case.spec.can_id == message.frame_id
    assert case.spec.cycle_ns == int(attribute(message, "GenMsgCycleTime", 0)) * 10**6
    assert case.spec.timeout_ns == int(attribute(message, "TimeoutTime", 0)) * 10**6
    assert case.spec.min_interval_ns == int(attribute(message, "GenMsgDelayTime", 0)) * 10**6


# The bus -----------------------------------------------------------------------------------------


def cyclic() -> list[MessageTiming]:
    return [
        MessageTiming(can_id=spec.can_id, length=spec.length, period_ns=spec.cycle_ns)
        for spec in SPECS.values()
        if spec.cycle_ns
    ]


def stormy() -> list[MessageTiming]:
    """Every node brakes, driver frames change in every cycle, the planner decides every 10 ms."""
    return [
        MessageTiming(can_id=spec.can_id, length=spec.length, jitter_ns=3_000_000,
                      period_ns=spec.cycle_ns if spec.data_id is None else 10_000_000)
        for spec in SPECS.values()
        if spec.cycle_ns or spec.data_id is not None
    ]


@pytest.mark.parametrize(("bitrate", "most"), [(500_000, 0.35), (250_000, 0.70)])
def test_the_bus_is_about_a_quarter_full_at_500_kbit_s(bitrate: int, most: float) -> None:
    load_ = bus_load(cyclic(), bitrate)
    assert 0.5 * most < load_ < most


def test_every_10_ms_frame_is_there_within_5_ms_even_at_half_the_bitrate() -> None:
    for bitrate in (500_000, 250_000):
        times = response_times_ns(cyclic(), bitrate)
        fast = [spec.can_id for spec in SPECS.values() if spec.cycle_ns == 10_000_000]
        assert len(fast) == 5 and max(times[can_id] for can_id in fast) < 5_000_000


def test_in_a_storm_every_emergency_frame_is_there_within_5_ms_and_the_rest_in_its_cycle() -> None:
    times = response_times_ns(stormy(), 500_000)
    assert max(times[0x010 + node] for node in NODES.values()) < 5_000_000
    assert max(times.values()) < 10_000_000


# The decision-age limit --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("period_ms", "limit_ms"),
    [(10, 70), (20, 85), (50, 130), (100, 205), (11, 75), (33, 105), (0.5, 60)],
)
def test_the_decision_age_limit_by_hand(period_ms: float, limit_ms: int) -> None:
    assert decision_age_limit_ms(period_ms) == limit_ms  # 1.5 x + 55 ms, up to the next 5 ms


@pytest.mark.parametrize("timeout_s", [0.1, 0.3, 1.0])
def test_the_slowest_planner_just_keeps_the_time_out(timeout_s: float) -> None:
    period_ms = planner_period_ms_max(timeout_s)
    assert decision_age_limit_ms(period_ms - 0.01) <= timeout_s * 1e3
    assert decision_age_limit_ms(period_ms + 0.1) > timeout_s * 1e3
