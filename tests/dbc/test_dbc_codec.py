"""The generated codec against cantools, bit for bit, for every signal of both DBC files."""

from __future__ import annotations

import math
from typing import Any

import pytest
from cantools.database.can import Signal
from hypothesis import given, settings
from hypothesis import strategies as st

from canbus.frame import Frame, FrameKind
from dbc.codec import Decoded, FrameFault, decode, decode_data, encode
from dbc.messages import SPECS, EmergencyBrake, ErrorCode, Reason, SupervisorState
from dbc.protection import protect
from dbc.spec import SignalRangeError
from tests.dbc.dbc_signals import (
    CASE_IDS,
    CASES,
    Case,
    choice_names,
    edge_raws,
    for_cantools,
    is_enum,
    is_valid,
    not_available,
    physical,
    raw_domain,
)

ALL = pytest.mark.parametrize("case", CASES, ids=CASE_IDS)


def lowest(case: Case) -> dict[str, int]:
    """A valid raw value for each signal."""
    return {signal.name: edge_raws(signal)[0] for signal in case.payload}


def both_agree(case: Case, raws: dict[str, int]) -> None:
    """cantools' bytes of these raw values are ours, and mean the same to us, and back."""
    reference = case.message.encode({**raws, **case.zero_protection}, scaling=False, strict=True)
    content = case.spec.unpack(int.from_bytes(reference, "little"))
    for signal in case.payload:
        value, wanted = getattr(content, signal.name), physical(signal, raws[signal.name])
        assert value == wanted or (math.isnan(value) and math.isnan(wanted)), signal.name
    assert case.spec.pack(content).to_bytes(case.spec.length, "little") == reference
    values = {s.name: for_cantools(s, getattr(content, s.name)) for s in case.payload}
    assert case.message.encode({**values, **case.zero_protection}, strict=True) == reference


@ALL
def test_every_edge_of_every_signal_is_coded_as_cantools_does(case: Case) -> None:
    base = lowest(case)
    both_agree(case, base)
    for signal in case.payload:
        for raw in edge_raws(signal):
            both_agree(case, {**base, signal.name: raw})


@ALL
def test_every_single_bit_of_a_signal_is_where_cantools_has_it(case: Case) -> None:
    base = lowest(case)
    for signal in case.payload:
        low, high = raw_domain(signal)
        for bit in range(signal.length):
            raw = 1 << bit
            raw = raw if raw <= high else low
            if is_valid(signal, raw):
                both_agree(case, {**base, signal.name: raw})


@ALL
@settings(max_examples=15, deadline=None, derandomize=True)
@given(data=st.data())
def test_random_values_are_coded_as_cantools_does(case: Case, data: st.DataObject) -> None:
    both_agree(
        case, {signal.name: data.draw(valid_raws(signal), signal.name) for signal in case.payload}
    )


def valid_raws(signal: Signal) -> st.SearchStrategy[int]:
    if is_enum(signal):
        return st.sampled_from(sorted(choice_names(signal)))
    low, high = raw_domain(signal)
    return st.integers(low, high).filter(lambda raw: is_valid(signal, raw))


def scaled(case: Case) -> list[Signal]:
    """Signals that hold a measured number."""
    return [s for s in case.payload if not is_enum(s) and s.length > 1]


@ALL
@settings(max_examples=15, deadline=None, derandomize=True)
@given(data=st.data())
def test_values_between_two_steps_are_rounded_as_cantools_does(
    case: Case, data: st.DataObject
) -> None:
    content = case.spec.unpack(
        int.from_bytes(case.message.encode({**lowest(case), **case.zero_protection}, scaling=False),
                       "little")
    )
    values = {signal.name: getattr(content, signal.name) for signal in case.payload}
    for signal in scaled(case):
        assert signal.minimum is not None and signal.maximum is not None
        if isinstance(values[signal.name], float):
            values[signal.name] = data.draw(st.floats(signal.minimum, signal.maximum), signal.name)
    ours = case.spec.pack(case.kind(**values)).to_bytes(case.spec.length, "little")
    theirs = {s.name: for_cantools(s, values[s.name]) for s in case.payload}
    assert ours == case.message.encode({**theirs, **case.zero_protection}, strict=True)


@ALL
def test_what_a_signal_cannot_carry_is_refused_by_name_and_range(case: Case) -> None:
    raws = case.message.encode({**lowest(case), **case.zero_protection}, scaling=False)
    content = case.spec.unpack(int.from_bytes(raws, "little"))
    good = {signal.name: getattr(content, signal.name) for signal in case.payload}
    for signal in scaled(case):
        assert signal.minimum is not None and signal.maximum is not None
        wrong = [math.inf, -math.inf, 1e300]
        wrong += [math.nextafter(signal.maximum, math.inf), math.nextafter(signal.minimum, -9e99)]
        if not_available(signal) is None:
            wrong.append(math.nan)
        for value in wrong:
            with pytest.raises(SignalRangeError) as caught:
                case.spec.pack(case.kind(**{**good, signal.name: value}))
            told = str(caught.value)
            assert f"{case.kind.__name__}.{signal.name} = " in told
            assert f"allowed {signal.minimum} to {signal.maximum}" in told and "\n" not in told


@ALL
def test_every_raw_value_that_means_nothing_is_refused_when_decoded(case: Case) -> None:
    base = case.message.encode({**lowest(case), **case.zero_protection}, scaling=False)
    for signal in case.payload:
        low, high = raw_domain(signal)
        candidates: Any = range(low, high + 1)
        if signal.length > 12:
            assert signal.minimum is not None and signal.maximum is not None
            first, last = round(signal.minimum / signal.scale), round(signal.maximum / signal.scale)
            candidates = (low, low + 1, first - 1, last + 1, high - 1, high)
        mask = (1 << signal.length) - 1 << signal.start
        for raw in candidates:
            if low <= raw <= high and not is_valid(signal, raw):
                bits = int.from_bytes(base, "little") & ~mask | raw << signal.start & mask
                with pytest.raises((SignalRangeError, KeyError)):
                    case.spec.unpack(bits)


@ALL
def test_every_name_of_a_value_table_fits_its_signal_and_is_an_enumeration(case: Case) -> None:
    for signal in filter(is_enum, case.payload):
        content = case.spec.unpack(
            int.from_bytes(
                case.message.encode({**lowest(case), **case.zero_protection}, scaling=False),
                "little",
            )
        )
        member = getattr(content, signal.name)
        assert {m.value: m.name for m in type(member)} == choice_names(signal)
        assert max(m.value for m in type(member)) < 1 << signal.length


# Frames ------------------------------------------------------------------------------------------

PROTECTED = [case for case in CASES if case.spec.data_id is not None]
PROTECTED_IDS = [case.message.name for case in PROTECTED]


@pytest.mark.parametrize("case", PROTECTED, ids=PROTECTED_IDS)
def test_a_protected_frame_carries_counter_and_content_where_the_dbc_says(case: Case) -> None:
    raws = lowest(case)
    plain = case.message.encode({**raws, **case.zero_protection}, scaling=False)
    content = case.spec.unpack(int.from_bytes(plain, "little"))
    for counter in range(15):
        frame = encode(case.spec, content, counter)
        read = case.message.decode(frame.data, scaling=False, decode_choices=False)
        assert isinstance(read, dict)
        assert read["alive_counter"] == counter and read["crc"] == frame.data[0]
        decoded = decode(frame)
        assert isinstance(decoded, Decoded)
        assert decoded.counter == counter and decoded.spec is case.spec
        assert case.spec.pack(decoded.message) == case.spec.pack(content)


@pytest.mark.parametrize("case", PROTECTED, ids=PROTECTED_IDS)
@pytest.mark.parametrize("fill", [0x00, 0xFF])
def test_a_blank_frame_is_never_a_valid_one(case: Case, fill: int) -> None:
    assert decode(Frame(case.spec.can_id, bytes([fill] * 8))) is FrameFault.CRC


@pytest.mark.parametrize("case", PROTECTED, ids=PROTECTED_IDS)
def test_a_frame_under_another_messages_identifier_is_corrupt(case: Case) -> None:
    raws = {signal.name: edge_raws(signal)[-1] for signal in case.payload}
    plain = case.message.encode({**raws, **case.zero_protection}, scaling=False)
    frame = encode(case.spec, case.spec.unpack(int.from_bytes(plain, "little")), 5)
    for other in PROTECTED:
        if other is not case:
            assert decode(Frame(other.spec.can_id, frame.data)) is FrameFault.CRC


def test_an_unknown_enumeration_value_under_a_good_crc_is_a_value_fault() -> None:
    spec = SPECS[0x015]
    assert isinstance(decode(Frame(0x015, protect(bytearray(8), 0x15, 3))), Decoded)
    for code in (7, 8, 14):
        data = bytearray((code << 32).to_bytes(8, "little"))
        assert decode(Frame(0x015, protect(data, 0x15, 3))) is FrameFault.VALUE
    data = bytearray((24 << 36).to_bytes(8, "little"))  # the first reason without a name
    assert spec.data_id is not None
    assert decode(Frame(0x015, protect(data, spec.data_id, 3))) is FrameFault.VALUE


def test_an_out_of_range_value_under_a_good_crc_is_a_value_fault() -> None:
    for position, is_fine in ((600, True), (601, False), (1022, False), (1023, True)):
        data = bytearray((position << 32).to_bytes(8, "little"))  # 600: 1.2 of the servo's travel
        decoded = decode(Frame(0x184, protect(data, 0x184, 0)))
        assert isinstance(decoded, Decoded) if is_fine else decoded is FrameFault.VALUE


@pytest.mark.parametrize("length", [n for n in range(9) if n != 8])
def test_another_length_is_a_length_fault(length: int) -> None:
    assert decode(Frame(0x181, bytes(length))) is FrameFault.LENGTH
    assert decode_data(0x001, bytes(length + 1)) is FrameFault.LENGTH


@pytest.mark.parametrize("kind", [kind for kind in FrameKind if kind is not FrameKind.DATA])
def test_another_kind_is_a_kind_fault(kind: FrameKind) -> None:
    assert decode(Frame(0x181, b"", kind)) is FrameFault.KIND


def test_an_identifier_of_nobodys_is_no_fault_and_no_message() -> None:
    assert decode(Frame(0x400, b"1234")) is None


def test_an_unprotected_frame_has_no_counter() -> None:
    decoded = decode(Frame(0x701, b"\5"))
    assert isinstance(decoded, Decoded) and decoded.counter is None
    assert encode(decoded.spec, decoded.message) == Frame(0x701, b"\5")
    assert decode(Frame(0x701, b"\6")) is FrameFault.VALUE


def test_encode_by_hand() -> None:
    """Bytes worked out on paper: code 4, reason 12, 300 ms, epoch 9 from bit 32 on."""
    message = EmergencyBrake(
        code=ErrorCode.ER4, reason=Reason.MOTOR_FAULT, cause_age_ms=300, reset_epoch=9
    )
    bits = 4 | 12 << 4 | 300 << 12 | 9 << 28
    frame = encode(SPECS[0x012], message, 2)
    assert frame.data[1:4] == bytes([2, 0, 0]) and frame.data[4:] == bits.to_bytes(4, "little")


def test_the_content_of_a_frame_is_shared_and_compares_by_value() -> None:
    """It is immutable for the type checker; nobody may lean on more than that."""
    first = decode(Frame(0x181, protect(bytearray(8), 0x181, 0)))
    second = decode(Frame(0x181, protect(bytearray(8), 0x181, 1)))
    assert isinstance(first, Decoded) and isinstance(first.message, SupervisorState)
    assert isinstance(second, Decoded) and first.message == second.message
    assert first is decode(Frame(0x181, protect(bytearray(8), 0x181, 0)))
    assert first.message in {second.message} and "reset_epoch=0" in repr(first.message)
