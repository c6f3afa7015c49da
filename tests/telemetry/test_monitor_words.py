"""CANopen and error frames in words."""

from __future__ import annotations

from importlib.resources import files

import pytest
from canopen.sdo.exceptions import SdoAbortedError

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.node import NODE_IDS
from dbc.messages import Reason
from dbc.spec import snake_case
from ecus.common.codes import EMCY_CODE_BASE
from gateway.sentences import REASON_TEXT
from telemetry.monitor.canopen_words import EMCY_DEVICE, CanopenWords
from telemetry.monitor.error_words import error_words
from telemetry.monitor.sdo_aborts import ABORT_TEXT

OWN = CanopenWords()
FOREIGN = CanopenWords(is_own=False)


def said(can_id: int, data: str = "", words: CanopenWords = OWN) -> str | None:
    return words.say(can_id, bytes.fromhex(data))


@pytest.mark.parametrize(
    ("can_id", "data", "words"),
    [
        (0x000, "01 02", "NMT: start: Steering"),
        (0x000, "82 00", "NMT: reset communication: all nodes"),
        (0x000, "07 00", "NMT: unknown command 7: all nodes"),
        (0x000, "01", "NMT: malformed"),
        (0x000, "01 80", "NMT: malformed"),
        (0x080, "", "SYNC"),
        (0x100, "00 00 00 00 00 00", "TIME"),
        (0x702, "00", "boot-up of Steering"),
        (0x702, "05", "heartbeat of Steering: operational"),
        (0x702, "7F", "heartbeat of Steering: pre-operational"),
        (0x711, "84", "heartbeat of node 17: stopped"),
        (0x702, "03", "heartbeat of Steering: unknown state 3"),
        (0x702, "05 00", "heartbeat of Steering: malformed"),
        (0x182, "", "TPDO1 of Steering"),
        (0x402, "", "RPDO3 of Steering"),
        (0x180, "", None),
        (0x700, "05", None),
        (0x7FF, "05", None),
        (0x67F, "40", "SDO to node 127: malformed"),
        (0x77F, "05", "heartbeat of node 127: operational"),
        (0x610, "4000100000000000", "SDO to node 16: read 0x1000:00"),
    ],
)
def test_frames_of_the_predefined_connection_set(
    can_id: int, data: str, words: str | None
) -> None:
    assert said(can_id, data) == words


DRIVES = CanopenWords(drives={0x11: "SteeringDrive", 0x12: "LeftWheelDrive"})


@pytest.mark.parametrize(
    ("can_id", "data", "words"),
    [
        (0x191, "37 06 DC FE FF FF 01",
         "TPDO1 of SteeringDrive: operation enabled, target reached; position -292, "
         "profile position"),
        (0x191, "08 02 00 00 00 00 00", "TPDO1 of SteeringDrive: fault; position 0, none"),
        (0x191, "6F 02 00 00 00 00 09",
         "TPDO1 of SteeringDrive: status 0x026F; position 0, mode 9"),
        (0x292, "37 02 90 01 00 00 38 FF",
         "TPDO2 of LeftWheelDrive: operation enabled; velocity 400 rpm, current -200 mA"),
        (0x211, "3F 00 10 27 00 00",
         "RPDO1 of SteeringDrive: enable operation, new setpoint; target position 10000"),
        (0x211, "06 01 00 00 00 00", "RPDO1 of SteeringDrive: shutdown; target position 0"),
        (0x312, "0F 01 9C FF FF FF",
         "RPDO2 of LeftWheelDrive: enable operation, halt; target velocity -100 rpm"),
        (0x312, "80 00 00 00 00 00",
         "RPDO2 of LeftWheelDrive: fault reset; target velocity 0 rpm"),
        (0x191, "37 06", "TPDO1 of SteeringDrive: malformed"),
        (0x391, "37 06", "TPDO3 of SteeringDrive"),
        (0x711, "05", "heartbeat of SteeringDrive: operational"),
        (0x712, "00", "boot-up of LeftWheelDrive"),
        (0x611, "40 81 60 00 00 00 00 00",
         "SDO to SteeringDrive: read 0x6081:00 Profile velocity"),
        (0x091, "11 86 20 00 00 00 00 00",
         "EMCY of SteeringDrive: 0x8611 monitoring, register 0x20, 00 00 00 00 00"),
        (0x182, "", "TPDO1 of Steering"),
    ],
)
def test_a_drive_s_frames_tell_what_it_does(can_id: int, data: str, words: str) -> None:
    assert said(can_id, data, DRIVES) == words


@pytest.mark.parametrize("command", list(NmtCommand))
def test_every_nmt_command_has_words(command: NmtCommand) -> None:
    text = OWN.say(0, nmt_frame(command, 0).data)
    assert text is not None and "unknown" not in text


def test_an_emcy_tells_code_reason_and_what_is_latched() -> None:
    assert EMCY_DEVICE == EMCY_CODE_BASE
    reason = Reason.MOTOR_FAULT
    data = f"04FF 81 04 {reason:02X} 14 0000"
    assert said(0x082, data) == f"EMCY of Steering: ER4: {REASON_TEXT[reason]}; latched ER2 ER4"
    assert said(0x082, "0000 00 0F 00 00 0000") == "EMCY of Steering: error reset"
    assert said(0x082, "0000 00 0F 00 01 0000") == "EMCY of Steering: error reset, latched ER0"
    assert said(0x082, "04FF 81 09 FE 00 0000") == (
        "EMCY of Steering: code 9: reason 254; latched none"
    )
    assert said(0x082, "04FF") == "EMCY of Steering: malformed"


def test_a_foreign_emcy_tells_its_class_register_and_bytes() -> None:
    text = said(0x091, "1082 10 01 02 03 04 05", FOREIGN)
    assert text == "EMCY of node 17: 0x8210 protocol, register 0x10, 01 02 03 04 05"
    assert said(0x091, "10FF 10 01 02 03 04 05", FOREIGN) == (
        "EMCY of node 17: 0xFF10 device specific, register 0x10, 01 02 03 04 05"
    )
    assert "0x9999 external error" in str(said(0x091, "9999 00 0000000000", FOREIGN))
    assert "0xB000 unknown" in str(said(0x091, "00B0 00 0000000000", FOREIGN))


@pytest.mark.parametrize(
    ("can_id", "data", "words"),
    [
        (0x602, "40 0021 01 00000000", "read 0x2100:01 position_gain_per_s"),
        (0x582, "43 0021 01 28230000", "answer 0x2100:01 position_gain_per_s = 9 1/s"),
        (0x602, "23 0021 01 28230000", "write 0x2100:01 position_gain_per_s = 9 1/s"),
        (0x582, "60 0021 01 00000000", "written 0x2100:01 position_gain_per_s"),
        (0x582, "80 0021 01 32000906",
         "abort 0x2100:01 position_gain_per_s: value too low (0x06090032)"),
        (0x602, "80 0021 01 00000000",
         "abort 0x2100:01 position_gain_per_s: unknown abort code (0x00000000)"),
        (0x582, "41 0810 00 0C000000",
         "answer 0x1008:00 Manufacturer device name in segments, 12 bytes"),
        (0x582, "40 0810 00 0C000000", "answer 0x1008:00 Manufacturer device name in segments"),
        (0x602, "60 0000 00 00000000", "read the next segment"),
        (0x582, "00 53746565726900", "read segment 53 74 65 65 72 69 00"),
        (0x582, "05 5374656572 0000", "read segment 'Steer', the last"),
        (0x582, "4F 0110 00 00000000", "answer 0x1001:00 Error register = 0"),
        (0x582, "43 1810 02 10000000", "answer 0x1018:02 Product code = 16 (0x10)"),
        (0x582, "43 3412 05 01020304", "answer 0x1234:05 = 01 02 03 04"),
        (0x602, "A0 0810 00 00000000", "block read"),
        (0x602, "E0 0000 00 00000000", "unknown command 0xE0"),
    ],
)  # fmt: skip
def test_sdo_names_objects_and_scales_values(can_id: int, data: str, words: str) -> None:
    way = "to" if can_id == 0x602 else "from"
    assert said(can_id, data) == f"SDO {way} Steering: {words}"


def test_an_object_of_a_foreign_node_has_its_number_alone() -> None:
    assert said(0x602, "40 0021 01 00000000", FOREIGN) == "SDO to node 2: read 0x2100:01"


def test_abort_codes_are_those_that_the_canopen_library_knows() -> None:
    assert ABORT_TEXT.keys() == SdoAbortedError.CODES.keys()


def test_every_node_has_an_eds_under_the_name_that_is_looked_for() -> None:
    for name, node_id in NODE_IDS.items():
        text = said(0x600 + node_id, "40 0010 00 00000000")
        assert text == f"SDO to {name}: read 0x1000:00 Device type"
    names = {path.name for path in files("dbc").joinpath("eds").iterdir()}
    assert names == {f"{snake_case(name)}.eds" for name in NODE_IDS} | {"drive.eds"}


@pytest.mark.parametrize(
    ("classes", "data", "words"),
    [
        (0x001, "", "transmission timed out"),
        (0x002, "05", "arbitration lost: at bit 5"),
        (0x002, "", "arbitration lost"),
        (0x004, "00 01", "controller: receive buffer overflowed"),
        (0x004, "00 30", "controller: error passive by receive errors, error passive by transmit "
                         "errors"),
        (0x008, "00 00 04 0A", "protocol violated: bit stuffing in data"),
        (0x008, "00 00 80 19", "protocol violated: while sending in acknowledge slot"),
        (0x008, "00 00 00 08", "protocol violated: in CRC"),
        (0x008, "00 00 00 01", "protocol violated: in place 0x01"),
        (0x010, "00 00 00 00 04", "trouble in the transceiver: CANH: no wire"),
        (0x010, "00 00 00 00 66", "trouble in the transceiver: CANH: short to supply, CANL: short "
                                  "to supply"),
        (0x010, "00 00 00 00 0F", "trouble in the transceiver: status 0x0F"),
        (0x040, "", "BUS-OFF"),
        (0x200, "00 00 00 00 00 00 60 7F", "errors were counted: 96 transmit, 127 receive"),
        (0x080, "00 00 00 00 00 00 60 7F", "bus error; error counters 96 transmit, 127 receive"),
        (0x064, "00 04", "controller: warning level of receive errors; nobody acknowledged; "
                         "BUS-OFF"),
        (0x8000, "", "unknown classes 0x8000"),
        (0, "", "no class given"),
    ],
)  # fmt: skip
def test_error_frames_in_words(classes: int, data: str, words: str) -> None:
    assert error_words(classes, bytes.fromhex(data)) == words
