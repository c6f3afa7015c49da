"""The section [drives]: optional as a whole, and as strict as the others where it is there."""

from __future__ import annotations

import pytest

from canbus.canopen_protocol import NODE_ID_MAX
from canbus.cia402 import DRIVE_NODE_ID_MIN, identifiers
from dbc.messages import SPECS
from tests.vehicles.drive_car import CAR, DRIVES, GEAR, TEXT
from vehicles import known_vehicles, load_vehicle
from vehicles.reading import read_vehicle
from vehicles.vehicle import Drives


def told(text: str) -> list[str]:
    """What is wrong, each as the line's own text and the words."""
    vehicle, problems = read_vehicle(text)
    assert (vehicle is None) == bool(problems)
    lines = text.splitlines()
    return [f"{lines[p.line - 1].split(' ')[0]}: {p.text}" for p in problems]


def changed(old: str, new: str) -> str:
    assert TEXT.count(old) == 1
    return TEXT.replace(old, new)


def test_a_car_has_drives_or_has_none() -> None:
    assert CAR.drives is not None
    assert CAR.drive_node_ids == (0x11, 0x12, 0x13)
    assert CAR.drives.encoder_counts_per_rev == 4096.0
    assert load_vehicle("tabby_evo").drives is None
    assert load_vehicle("tabby_evo").drive_node_ids == ()


def test_a_section_that_is_there_must_be_whole() -> None:
    assert told(TEXT.replace(DRIVES, "\n[drives]\n")) == [
        f'[drives]: drives.{name} is missing: wanted {{ value = ..., source = "..." }}'
        for name in Drives.__dataclass_fields__
    ]
    assert told("drives = 3\n" + TEXT.replace(DRIVES, ""))[0].endswith(
        "drives: the section is missing"
    )


@pytest.mark.parametrize("value", ["0x10", "128", "17.0", "17.5", "true", '"17"', "nan"])
def test_a_node_id_is_whole_and_in_the_drives_range(value: str) -> None:
    (problem,) = told(changed("value = 0x11", f"value = {value}"))
    assert problem.startswith("steering_node_id: drives.steering_node_id = ")
    assert problem.endswith(": allowed 17 to 127, whole")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("value = 4096", "value = 15.9", "encoder_counts_per_rev = 15.9: allowed 16 to 1e+06"),
        (GEAR, GEAR.replace("20.0", "1001.0"), "steering_gear_ratio = 1001.0: allowed 0.5 to 1000"),
    ],
)
def test_a_number_of_a_drive_out_of_its_range_is_named(old: str, new: str, words: str) -> None:
    (problem,) = told(changed(old, new))
    assert problem.endswith(f"drives.{words}")


def test_two_drives_of_one_node_id_are_refused() -> None:
    (problem,) = told(changed("value = 0x13", "value = 0x11"))
    assert problem == (
        "right_wheel_node_id: drives.right_wheel_node_id = 17: "
        "steering_node_id has it: one node, one id"
    )


def test_the_range_is_the_drives_and_no_identifier_of_theirs_is_ours() -> None:
    metadata = Drives.__dataclass_fields__["steering_node_id"].metadata
    assert (metadata["low"], metadata["high"]) == (DRIVE_NODE_ID_MIN, NODE_ID_MAX)
    everything = identifiers(range(metadata["low"], metadata["high"] + 1))
    assert not everything & set(SPECS)
    for name in known_vehicles():
        bus = load_vehicle(name).bus
        assert not any(bus.foreign_id_min <= i <= bus.foreign_id_max for i in everything)
