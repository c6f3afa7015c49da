"""A vehicle file that cannot be used is refused in one line: file, field, value, range."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from vehicles import VehicleError, known_vehicles, load_vehicle, parse_vehicle
from vehicles.reading import read_vehicle
from vehicles.vehicle import DriverPolicy, Vehicle

TEXT = load_vehicle("tabby_evo").text
ORIGIN = "my_car.toml"
OPTIONAL = {
    ("steering", "zero_rad"),
    ("traction", "reverse_speed_mps_max"),
    ("traction", "drive_lag_s"),
}
"""Fields that a file may leave out."""


def refused(text: str) -> str:
    """The one line with which this text is refused."""
    with pytest.raises(VehicleError) as caught:
        parse_vehicle(text, ORIGIN)
    told = str(caught.value)
    assert told.startswith(f"{ORIGIN}: ") and "\n" not in told
    return told


def with_value(section: str, field: str, value: str) -> str:
    """The file with another value of one field, as TOML writes it."""
    return with_line(section, field, r"{ value = [^,]+,(.*)", rf"{field} = {{ value = {value},\1")


def with_line(section: str, field: str, old: str, new: str) -> str:
    """The file with another line for one field of one section."""
    head, tail = TEXT.split(f"\n[{section}]\n", 1)
    if (section, field) in OPTIONAL and not re.search(rf"^{field} =", TEXT, flags=re.M):
        tail = f'{field} = {{ value = 0.0, source = "assumption" }}\n{tail}'
    changed, count = re.subn(rf"^{field} = {old}$", new, tail, count=1, flags=re.M)
    assert count == 1
    return f"{head}\n[{section}]\n{changed}"


def numbers() -> list[tuple[str, str, float, float]]:
    """Every numeric field: section, name, smallest and largest value."""
    vehicle = load_vehicle("tabby_evo")
    found = []
    for section in fields(Vehicle):
        part: Any = getattr(vehicle, section.name)
        if not isinstance(part, str | None):
            for field in fields(part):
                if "low" in field.metadata:
                    low, high = field.metadata["low"], field.metadata["high"]
                    found.append((section.name, field.name, low, high))
    return found


NUMBERS = pytest.mark.parametrize(("section", "field", "low", "high"), numbers())
POLICIES = pytest.mark.parametrize("field", ["driver_steers_against", "driver_brakes_alone"])


# The file itself ---------------------------------------------------------------------------------


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(VehicleError) as caught:
        load_vehicle("tabby")
    told = str(caught.value)
    assert told.startswith("vehicle 'tabby' is not known: allowed ") and "\n" not in told
    assert "tabby_evo" in told and ".toml" in told
    assert "tabby_evo" in known_vehicles()


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = str(tmp_path / "none.toml")
    with pytest.raises(VehicleError, match="cannot be read") as caught:
        load_vehicle(path)
    assert str(caught.value).startswith(path) and "\n" not in str(caught.value)


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(VehicleError, match="cannot be read"):
        load_vehicle(str(path))


def test_a_file_by_path_is_the_same_as_by_name(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_text(TEXT, encoding="utf-8")
    assert load_vehicle(str(path)) == load_vehicle("tabby_evo")


def test_bad_toml_is_refused_with_its_place() -> None:
    assert re.search(r"not valid TOML: .*line 2", refused("name = 'x'\n[geometry\n"))


@pytest.mark.parametrize("line", ["", 'name = ""\n', "name = 3\n", "name = ['a']\n"])
def test_the_name_must_be_a_text(line: str) -> None:
    told = refused(TEXT.replace('name = "tabby_evo"\n', line))
    assert "name = " in told and "non-empty text" in told


# Sections and fields -----------------------------------------------------------------------------

SECTIONS = sorted({section for section, *_ in numbers()})


@pytest.mark.parametrize("section", SECTIONS)
def test_each_section_must_be_there(section: str) -> None:
    told = refused(re.sub(rf"^\[{section}\]\n(?:.+\n)+", "", TEXT, flags=re.M))
    assert told == f"{ORIGIN}: {section}: the section is missing"


def test_an_unknown_section_is_refused_with_the_known_ones() -> None:
    told = refused(f"{TEXT}\n[engine]\ncylinders = 4\n")
    assert "[engine] is not known" in told and all(section in told for section in SECTIONS)


def test_a_section_that_is_none_is_missing() -> None:
    text = re.sub(r"^\[bus\]\n(?:.+\n)+", "", TEXT, flags=re.M)
    assert refused(f"bus = 3\n{text}") == f"{ORIGIN}: bus: the section is missing"


@pytest.mark.parametrize("section", SECTIONS)
def test_an_unknown_field_is_refused_with_the_known_ones(section: str) -> None:
    told = refused(TEXT.replace(f"\n[{section}]\n", f"\n[{section}]\ncolour = 1\n"))
    assert told.startswith(f"{ORIGIN}: {section}.colour is not known: allowed ")


@NUMBERS
def test_each_field_must_be_there(section: str, field: str, low: float, high: float) -> None:
    text = with_line(section, field, ".*", "")
    if (section, field) in OPTIONAL:
        assert getattr(getattr(parse_vehicle(text, ORIGIN), section), field) == 0.0
        return
    told = refused(text)
    assert told.startswith(f"{ORIGIN}: {section}.{field} is missing: wanted ")


@POLICIES
def test_each_policy_must_be_there(field: str) -> None:
    told = refused(re.sub(rf"^{field} = .*\n", "", TEXT, count=1, flags=re.M))
    assert told.startswith(f"{ORIGIN}: policy.{field} is missing: wanted ")


@pytest.mark.parametrize(
    "entry",
    [
        "2.36", "{ value = 2.36 }", '{ source = "measured" }', "{}", "[2.36]", '"2.36"',
        '{ value = 2.36, source = "measured", unit = "m" }',
    ],
)
def test_a_field_is_a_value_with_its_source_and_nothing_else(entry: str) -> None:
    told = refused(re.sub(r"^wheelbase_m = .*$", f"wheelbase_m = {entry}", TEXT, flags=re.M))
    assert told == (
        f'{ORIGIN}: geometry.wheelbase_m is missing: wanted {{ value = ..., source = "..." }}'
    )


@pytest.mark.parametrize("source", ['""', '"  "', "3", "true"])
def test_an_empty_source_is_refused(source: str) -> None:
    entry = f"wheelbase_m = {{ value = 2.36, source = {source} }}"
    told = refused(re.sub(r"^wheelbase_m = .*$", entry, TEXT, flags=re.M))
    assert told.startswith(f"{ORIGIN}: geometry.wheelbase_m: the source is missing")


# Values ------------------------------------------------------------------------------------------


@NUMBERS
def test_every_number_out_of_its_range_is_refused(
    section: str, field: str, low: float, high: float
) -> None:
    span = high - low
    for value in (low - 0.001 * span, high + 0.001 * span, -1e300, 1e300, 10**400):
        told = refused(with_value(section, field, repr(value)))
        assert told == f"{ORIGIN}: {section}.{field} = {value!r}: allowed {low:g} to {high:g}"


@NUMBERS
def test_the_ends_of_a_range_are_in_it(section: str, field: str, low: float, high: float) -> None:
    for value in (low, high):
        try:
            vehicle: Any = parse_vehicle(with_value(section, field, repr(value)), ORIGIN)
        except VehicleError as error:
            assert "must be at least" in str(error)  # another field stands in its way
        else:
            assert getattr(getattr(vehicle, section), field) == value


@NUMBERS
def test_no_number_may_be_nan_infinite_a_truth_value_or_a_text(
    section: str, field: str, low: float, high: float
) -> None:
    for value in ("nan", "inf", "-inf", "true", "false", '"1.0"', "[1.0]", "{}", "1979-05-27"):
        told = refused(with_value(section, field, value))
        assert told.startswith(f"{ORIGIN}: {section}.{field} = ")
        assert told.endswith(f": allowed {low:g} to {high:g}")


@POLICIES
@pytest.mark.parametrize("value", ['"brake"', '""', '"MANUAL"', "1", "true", "[]"])
def test_a_policy_is_one_of_its_words(field: str, value: str) -> None:
    told = refused(with_value("policy", field, value))
    assert told.startswith(f"{ORIGIN}: policy.{field} = ")
    assert told.endswith(": allowed manual, emergency")


@POLICIES
def test_each_word_of_a_policy_is_understood(field: str) -> None:
    for word in DriverPolicy:
        vehicle = parse_vehicle(with_value("policy", field, f'"{word}"'), ORIGIN)
        assert getattr(vehicle.policy, field) is word


def test_a_whole_number_is_a_number() -> None:
    vehicle = parse_vehicle(with_value("geometry", "mass_kg", "900"), ORIGIN)
    assert vehicle.geometry.mass_kg == 900.0 and isinstance(vehicle.geometry.mass_kg, float)


# Relations ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("section", "field", "just_enough", "too_little", "why"),
    [
        ("brake", "on_time_s_max", "9.88", "9.86", "three times the longest stop (9.87)"),
        ("steering", "sensor_angle_rad_max", "9.25", "9.24",
         "steering.wheel_angle_rad_max and the size of steering.zero_rad (9.25)"),
        ("traction", "speed_mps_max", "1.5", "1.4", "traction.reverse_speed_mps_max (1.5)"),
        ("envelope", "speed_mps_max", "7.5", "7.4", "traction.speed_mps_max (7.5)"),
        ("envelope", "wheel_angle_rad_max", "9.25", "9.2", "steering.wheel_angle_rad_max (9.25)"),
        ("envelope", "wheel_rate_radps_max", "8.73", "8.7", "steering.wheel_rate_radps_max (8.73)"),
        ("brake", "deceleration_mps2_full", "2.5", "2.4", "brake.deceleration_mps2_min (2.5)"),
        ("bus", "foreign_id_max", "0x400", "0x3FF", "bus.foreign_id_min (1024)"),
    ],
)
def test_each_relation_holds_at_its_edge_and_is_refused_below(
    section: str, field: str, just_enough: str, too_little: str, why: str
) -> None:
    parse_vehicle(with_value(section, field, just_enough), ORIGIN)
    told = refused(with_value(section, field, too_little))
    number = float(int(too_little, 0) if too_little.startswith("0x") else too_little)
    assert told.startswith(f"{ORIGIN}: {section}.{field} = {number:g}: must be at least")
    assert told.endswith(why)


@pytest.mark.parametrize("sign", ["", "-"])
def test_the_zero_must_leave_the_sensor_the_whole_range(sign: str) -> None:
    parse_vehicle(with_value("steering", "zero_rad", f"{sign}0.34"), ORIGIN)  # 9.6 less 9.25
    told = refused(with_value("steering", "zero_rad", f"{sign}0.36"))
    assert told.endswith("the size of steering.zero_rad (9.61)")


# All problems ------------------------------------------------------------------------------------


def lines_told(text: str) -> dict[str, str]:
    """What is wrong, by the text of its line."""
    lines = text.splitlines()
    vehicle, problems = read_vehicle(text)
    assert (vehicle is None) == bool(problems)
    return {lines[problem.line - 1]: problem.text for problem in problems}


def test_a_good_file_has_no_problems() -> None:
    assert lines_told(TEXT) == {}


@NUMBERS
def test_a_number_out_of_its_range_is_named_with_its_line(
    section: str, field: str, low: float, high: float
) -> None:
    text = with_value(section, field, "1e300")
    told = lines_told(text)
    (line,) = [line for line, what in told.items() if what.startswith(f"{section}.{field} = ")]
    assert line.startswith(f"{field} = {{ value = 1e300")


def test_every_problem_is_named_and_in_the_order_of_the_lines() -> None:
    text = TEXT.replace("value = 40.0", "value = 400.0").replace("value = 2.360", "value = -1")
    text = text.replace("\n[envelope]", "\n[envelope]\ncolour = 1").replace('"manual"', '"maybe"')
    text = text.replace("value = 9.6", "value = 9.0") + "\n[engine]\ncylinders = 4\n"
    _, problems = read_vehicle(text)
    assert [problem.text.split(" ")[0] for problem in problems] == [
        "geometry.wheelbase_m", "steering.ratio", "envelope.colour", "policy.driver_steers_against",
        "policy.driver_brakes_alone", "[engine]",
    ]
    assert [problem.line for problem in problems] == sorted(problem.line for problem in problems)


def test_relations_of_sections_without_a_problem_are_checked_beside_other_problems() -> None:
    text = TEXT.replace("value = 2.360", "value = -1").replace("value = 30.0", "value = 6.0")
    told = list(lines_told(text).values())
    assert told[0].startswith("geometry.wheelbase_m = -1")
    assert told[1].startswith("brake.on_time_s_max = 6: must be at least three times")


def test_what_is_missing_is_named_at_its_section_and_bad_toml_at_its_line() -> None:
    assert lines_told(re.sub(r"^mass_kg.*\n", "", TEXT, flags=re.M)) == {
        "[geometry]": 'geometry.mass_kg is missing: wanted { value = ..., source = "..." }'
    }
    _, (problem,) = read_vehicle(TEXT.replace("\n[brake]", "\n[brake"))
    assert problem.line == 1 + TEXT.splitlines().index("[brake]")
    _, (problem,) = read_vehicle('name = "x"\n\n\n[geometry')
    assert problem.line == 4
