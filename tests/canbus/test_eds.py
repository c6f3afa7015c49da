"""The EDS files: complete after CiA 306, and the parameters the vehicle files must give."""

from __future__ import annotations

from configparser import RawConfigParser
from dataclasses import fields
from importlib.resources import files

import canopen
import pytest
from canopen.objectdictionary import ODRecord, ODVariable

from canbus.canopen_node import CanopenNode
from canbus.canopen_parameters import Parameter
from canbus.node import NODE_IDS
from vehicles.reading import SECTIONS

# Written a second time by hand: name, smallest and largest value in SI, unit.
PARAMETERS: dict[str, list[tuple[str, float, float, str]]] = {
    "supervisor": [
        ("ready_timeout_s", 5, 600, "s"),
        ("engage_speed_mps_max", 0, 15, "m/s"),
    ],
    "steering": [
        ("position_gain_per_s", 1, 40, "1/s"),
        ("rate_gain", 0, 5, "1"),
        ("integral_gain_per_s2", 0, 50, "1/s2"),
        ("wheel_rate_radps_max", 0.1, 20, "rad/s"),
        ("wheel_angle_rad_max", 0.05, 16, "rad"),
        ("driver_torque_nm_max", 0.5, 10, "N.m"),
        ("command_timeout_s", 0.06, 1.25, "s"),
    ],
    "throttle": [
        ("speed_gain", 0, 20, "1/s"),
        ("integral_gain_per_s", 0, 20, "1/s2"),
        ("feed_forward_gain", 0, 2, "1"),
        ("acceleration_mps2_max", 0.1, 10, "m/s2"),
        ("deceleration_mps2_max", 0.1, 10, "m/s2"),
        ("speed_mps_max", 0.2, 35, "m/s"),
        ("driver_pedal_ratio_max", 0.01, 0.5, "1"),
        ("command_timeout_s", 0.06, 1.25, "s"),
    ],
    "brake_servo": [
        ("on_time_s_max", 5, 300, "s"),
        ("driver_pedal_ratio_max", 0.01, 0.5, "1"),
        ("position_rate_per_s_max", 0.2, 100, "1/s"),
        ("command_timeout_s", 0.06, 1.25, "s"),
    ],
    "safety_monitor": [
        ("speed_mps_max", 0.2, 40, "m/s"),
        ("lateral_acceleration_mps2_max", 0.1, 15, "m/s2"),
        ("lateral_jerk_mps3_max", 0.1, 100, "m/s3"),
        ("wheel_angle_rad_max", 0.05, 16, "rad"),
        ("wheel_rate_radps_max", 0.1, 30, "rad/s"),
    ],
    "gateway": [("command_timeout_s", 0.06, 1.25, "s")],
}
NODES = dict(zip(PARAMETERS, (1, 2, 3, 4, 5, 6), strict=True))
READ_ONLY = ("safety_monitor", "gateway")
SUFFIX_UNITS = {
    "s": ("_s", "_s_max"),
    "m/s": ("_mps_max",),
    "m/s2": ("_mps2_max",),
    "m/s3": ("_mps3_max",),
    "rad": ("_rad_max",),
    "rad/s": ("_radps_max",),
    "N.m": ("_nm_max",),
    "1": ("_ratio_max", "_gain"),
    "1/s": ("_per_s", "_per_s_max", "speed_gain"),
    "1/s2": ("_per_s2", "integral_gain_per_s"),
}

DEVICES = NODES | {"drive": 0x11}
each_node = pytest.mark.parametrize("name", PARAMETERS)
MAPPINGS = (*range(0x1600, 0x1800), *range(0x1A00, 0x1C00))
each_device = pytest.mark.parametrize("name", DEVICES)


def eds_path(name: str) -> str:
    return str(files("dbc").joinpath("eds", f"{name}.eds"))


def load(name: str) -> canopen.ObjectDictionary:
    return canopen.import_od(eds_path(name), DEVICES[name])


def parse(name: str) -> RawConfigParser:
    parser = RawConfigParser()
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read(eds_path(name), encoding="ascii")
    return parser


def test_node_ids_are_those_of_the_node_contract() -> None:
    names = [name.replace("_", "") for name in PARAMETERS]
    assert dict(zip(names, NODES.values(), strict=True)) == {
        name.lower(): node_id for name, node_id in NODE_IDS.items()
    }


@each_device
def test_object_lists_name_every_object_once_and_nothing_else(name: str) -> None:
    parser = parse(name)
    listed: list[int] = []
    for section in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        entries = dict(parser[section])
        count = int(entries.pop("SupportedObjects"))
        assert list(entries) == [str(number) for number in range(1, count + 1)]
        listed += [int(value, 16) for value in entries.values()]
        manufacturer = section == "ManufacturerObjects"
        for index in map(int_of, entries.values()):
            assert (0x2000 <= index < 0x6000) is manufacturer
    assert listed[:3] == [0x1000, 0x1001, 0x1018]
    assert sorted(listed) == sorted(load(name))


def int_of(text: str) -> int:
    return int(text, 0)


@each_device
def test_records_hold_as_many_members_as_they_say(name: str) -> None:
    parser = parse(name)
    for index, entry in load(name).indices.items():
        if isinstance(entry, ODRecord):
            subindices = sorted(entry)
            assert subindices == list(range(len(subindices)))
            assert int(parser[f"{index:04X}"]["SubNumber"]) == len(subindices)
            used = len(subindices) - 1
            if index in MAPPINGS:  # sub-index 0 counts those in use
                used = sum(bool(entry[member].default) for member in subindices[1:])
            assert entry[0].default == used


@each_device
def test_every_variable_is_fully_described(name: str) -> None:
    # canopen ignores numbers it cannot read, so that a typing error would go unnoticed.
    parser = parse(name)
    for entry in load(name).indices.values():
        members = entry.values() if isinstance(entry, ODRecord) else [entry]
        for variable in members:
            assert isinstance(variable, ODVariable)
            section = f"{variable.index:04X}"
            if isinstance(entry, ODRecord):
                section += f"sub{variable.subindex:X}"
            assert int_of(parser[section]["ObjectType"]) == 7
            assert parser[section]["AccessType"] in ("ro", "rw", "const")
            assert variable.default is not None, section
            assert (variable.min is not None) == ("LowLimit" in parser[section]), section
            assert (variable.max is not None) == ("HighLimit" in parser[section]), section


@each_device
def test_identity_and_device_information_belong_together(name: str) -> None:
    dictionary, parser = load(name), parse(name)
    device = parser["DeviceInfo"]
    identity = dictionary[0x1018]
    assert isinstance(identity, ODRecord)
    assert identity[1].default == int_of(device["VendorNumber"])
    assert identity[2].default == int_of(device["ProductNumber"]) == DEVICES[name]
    assert identity[3].default == int_of(device["RevisionNumber"])
    title = dictionary[0x1008]
    assert isinstance(title, ODVariable)
    assert str(title.default) == device["ProductName"]
    assert parser["FileInfo"]["FileName"] == f"{name}.eds"
    assert dictionary.device_information.simple_boot_up_master == (name == "supervisor")
    assert 500_000 in dictionary.device_information.allowed_baudrates


@each_device
def test_identifiers_follow_the_predefined_connection_set(name: str) -> None:
    dictionary, node_id = load(name), DEVICES[name]
    emcy, sdo = dictionary[0x1014], dictionary[0x1200]
    assert isinstance(emcy, ODVariable)
    assert isinstance(sdo, ODRecord)
    assert emcy.default == 0x080 + node_id
    assert sdo[1].default == 0x600 + node_id
    assert sdo[2].default == 0x580 + node_id


@each_node
def test_configuration_hashes_are_read_only_unsigned32(name: str) -> None:
    record = load(name)[0x2000]
    assert isinstance(record, ODRecord)
    assert [(record[sub].name, len(record[sub]), record[sub].access_type) for sub in (1, 2)] == [
        ("dbc_hash", 32, "ro"),
        ("vehicle_hash", 32, "ro"),
    ]


@each_node
def test_parameters_have_the_agreed_names_limits_units_and_access(name: str) -> None:
    record = load(name)[0x2100]
    assert isinstance(record, ODRecord)
    found = []
    for subindex in filter(None, record):
        variable = record[subindex]
        parameter = Parameter.from_eds(variable)
        low, high = parameter.si(parameter.raw_min), parameter.si(parameter.raw_max)
        found.append((variable.name, low, high, variable.unit))
        assert variable.access_type == ("ro" if name in READ_ONLY else "rw")
        assert parameter.factor <= 0.001
        assert variable.description
        assert variable.name.endswith(SUFFIX_UNITS[variable.unit])
    assert found == PARAMETERS[name]


@each_node
def test_node_starts_from_its_file_with_every_limit(name: str) -> None:
    for column in (1, 2):
        values = {row[0]: float(row[column]) for row in PARAMETERS[name]}
        node = CanopenNode(
            NODES[name], eds_path(name), dbc_hash=1, vehicle_hash=2, parameters=values
        )
        assert node.parameters == values
        assert node.step(0)[0].can_id == 0x700 + NODES[name]


def test_a_value_that_a_vehicle_file_may_give_is_in_the_range_of_the_eds() -> None:
    """One range for each number: a file that `dbw vehicle check` accepts starts every node."""
    ranges: dict[str, list[tuple[float, float]]] = {}
    for name, kind in SECTIONS.items():
        for field in fields(kind):
            if "low" in field.metadata:
                key = "envelope" if name == "envelope" else "own"
                ranges.setdefault(f"{key} {field.name}", []).append(
                    (field.metadata["low"], field.metadata["high"])
                )
    checked = set()
    for node, parameters in PARAMETERS.items():
        key = "envelope" if node == "safety_monitor" else "own"
        for parameter, low, high, _ in parameters:
            for wanted in ranges.get(f"{key} {parameter}", []):
                if parameter != "integral_gain_per_s2":  # the throttle's has another name
                    assert wanted == (low, high), (node, parameter)
                    checked.add((node, parameter))
    assert len(checked) >= 18
