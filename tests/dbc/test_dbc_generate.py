"""The generated modules are what the DBC files say, to the letter."""

from __future__ import annotations

from pathlib import Path

import pytest

import dbc.generate
from dbc import byte_commands, harness, messages
from dbc.database import (
    BYTE_COMMANDS_DBC,
    HARNESS_DBC,
    VEHICLE_DBC,
    configuration_hash,
    dbc_hash,
    dbc_text,
)
from dbc.generate import generate
from dbc.spec import snake_case

FILES = {
    VEHICLE_DBC: Path(messages.__file__),
    HARNESS_DBC: Path(harness.__file__),
    BYTE_COMMANDS_DBC: Path(byte_commands.__file__),
}


@pytest.mark.parametrize("name", FILES)
def test_the_shipped_module_is_the_generated_one(name: str) -> None:
    assert generate(name) == FILES[name].read_text(encoding="utf-8"), "run python -m dbc.generate"


def test_run_as_a_command_it_writes_its_modules_beside_itself(tmp_path: Path) -> None:
    source = Path(dbc.generate.__file__)
    code = compile(source.read_text(encoding="utf-8"), str(source), "exec")
    exec(code, {"__name__": "__main__", "__file__": str(tmp_path / "generate.py")})
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in FILES.values()}
    for name, path in FILES.items():
        assert (tmp_path / path.name).read_text(encoding="utf-8") == generate(name)


@pytest.mark.parametrize(
    ("camel", "expected"),
    [("Nmt", "nmt"), ("SteerStatus", "steer_status"), ("HeartbeatState", "heartbeat_state")],
)
def test_class_names_become_snake_case(camel: str, expected: str) -> None:
    assert snake_case(camel) == expected


def test_the_hash_of_a_text_changes_with_one_letter_and_fits_32_bits() -> None:
    assert configuration_hash("abc") == 0xBA7816BF  # FIPS 180-2, SHA-256 of "abc"
    assert configuration_hash("abd") != configuration_hash("abc")
    assert dbc_hash() == configuration_hash(dbc_text(VEHICLE_DBC))
    assert 0 <= dbc_hash() < 1 << 32
