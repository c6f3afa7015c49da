"""Faults as data: what may be asked for, what is refused and how it is told."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from simulation.fault_kinds import KINDS, TARGETS, FaultKind, Strikes, targets_of
from simulation.faults import Fault, FaultError, FaultPlan, parse_faults, read_faults
from vehicles import load_vehicle

TABBYS = targets_of(load_vehicle("tabby_evo"))
ALL = {kind: TARGETS[spec.strikes] for kind, spec in KINDS.items()}

STORM = """
# a storm
[[fault]]
kind = "crash"
target = "Steering"
at_s = 3.5

[[fault]]
kind = "drop"
target = "*"
per_h = 720
for_s = 0.2
share = 0.5
"""


@pytest.mark.parametrize("kind", FaultKind)
def test_every_kind_is_made_with_its_own_value_and_tells_what_it_does(kind: FaultKind) -> None:
    spec = KINDS[kind]
    for target in TARGETS[spec.strikes]:
        fault = Fault(kind=kind, target=target, at_s=1.0)
        assert fault.value == spec.default
        assert str(fault).startswith(f"at 1 s: {kind}") and target in str(fault)
        assert "{" not in str(fault)


@pytest.mark.parametrize(
    "kind", [kind for kind, spec in KINDS.items() if spec.low < spec.high]
)
def test_a_value_outside_its_range_is_refused_with_the_range(kind: FaultKind) -> None:
    spec = KINDS[kind]
    target = TARGETS[spec.strikes][0]
    for value in (spec.low, spec.high):
        assert Fault(kind=kind, target=target, value=value).value == value
    for value in (spec.low - 1e-3, spec.high + 1e-3, math.inf, -math.inf):
        with pytest.raises(FaultError, match=r"value \S+: allowed \S+ to \S+$"):
            Fault(kind=kind, target=target, value=value)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"target": "Nobody"}, "target 'Nobody': allowed for crash is Supervisor, Steering, "),
        ({"target": ""}, "target '': allowed for crash is Supervisor"),
        ({"at_s": -1.0}, "at_s -1: allowed 0 or more"),
        ({"at_s": math.inf}, "at_s inf: allowed 0 or more"),
        ({"at_s": math.nan}, "at_s nan: allowed 0 or more"),
        ({"for_s": -0.1}, "for_s -0.1: allowed 0 or more"),
        ({"share": 1.1}, "share 1.1: allowed 0 to 1"),
        ({"share": 0.5}, "share 0.5: crash strikes always"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(changes: dict[str, object], text: str) -> None:
    fields = {"kind": FaultKind.CRASH, "target": "Steering", **changes}
    with pytest.raises(FaultError, match=text):
        Fault(**fields)  # type: ignore[arg-type]


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "storm.toml"
    path.write_text(STORM, encoding="utf-8")
    plan = parse_faults(read_faults(path), "storm", ALL)
    assert plan.fixed == (Fault(kind=FaultKind.CRASH, target="Steering", at_s=3.5),)
    assert plan.rates[0].per_h == 720.0 and plan.rates[0].fault.share == 0.5


def test_a_rate_is_drawn_anew_and_alike_for_each_seed() -> None:
    plan = parse_faults(STORM, "storm", ALL)
    draws = [plan.draw(600.0, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert draws[0] == draws[1] != draws[2]
    drops = [fault for fault in draws[0] if fault.kind is FaultKind.DROP]
    assert 80 <= len(drops) <= 160  # 120 on average
    assert len({fault.target for fault in drops}) > 10
    times = [fault.at_s for fault in draws[0]]
    assert times == sorted(times) and max(times) < 600.0
    assert FaultPlan().draw(10.0, np.random.default_rng(0)) == []


def bad(text: str) -> str:
    """One table in a file whose first lines are a comment."""
    return f"# faults\n\n[[fault]]\n{text}"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "wanted is a list of [[fault]] tables and nothing else"),
        ("speed = 3", "wanted is a list of [[fault]] tables and nothing else"),
        ("[[fault]]\nkind=\"drop\"\ntarget=\"STEER_STATUS\"\nat_s=1\n[other]\n", "nothing else"),
        ("fault = = 1", "line 1"),
        (bad('kind = "explode"\nat_s = 1'), "line 3: kind 'explode': allowed drop, delay, "),
        (bad("at_s = 1"), "line 3: kind None: allowed drop"),
        (bad('kind = "drop"\nwhen = 1'), "line 3: when is not known: allowed kind, target, "),
        (bad('kind = "drop"'), "line 3: either at_s or per_h is wanted"),
        (bad('kind = "drop"\nat_s = 1\nper_h = 1'), "line 3: either at_s or per_h"),
        (bad('kind = "drop"\nat_s = "1"'), "line 3: at_s '1': a number is wanted"),
        (bad('kind = "drop"\nat_s = true'), "line 3: at_s True: a number is wanted"),
        (bad('kind = "drop"\nat_s = nan'), "line 3: at_s NaN: a number is wanted"),
        (bad('kind = "drop"\ntarget = 3\nat_s = 1'), "line 3: target 3: a text is wanted"),
        (bad('kind = "drop"\ntarget = "*"\nat_s = 1'), "line 3: target '*' needs per_h"),
        (bad('kind = "flood"\ntarget = "*"\nper_h = 1'), "line 3: target '*': allowed for flood"),
        (bad('kind = "flood"\nper_h = 1e6'), "line 3: per_h 1e+06: allowed 0 to 36000"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_with_line_and_reason(text: str, told: str) -> None:
    with pytest.raises(FaultError) as refusal:
        parse_faults(text, "storm.toml", ALL)
    assert str(refusal.value).startswith("storm.toml: ") and told in str(refusal.value)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FaultError, match=r"missing.toml: No such file"):
        read_faults(tmp_path / "missing.toml")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FaultError, match="no UTF-8 text"):
        read_faults(tmp_path / "binary")


@pytest.mark.parametrize(
    "kind", [kind for kind, spec in KINDS.items() if spec.strikes is Strikes.DRIVE]
)
def test_a_fault_of_a_drive_is_refused_for_a_car_without_drives(kind: FaultKind) -> None:
    text = bad(f'kind = "{kind}"\ntarget = "LeftWheelDrive"\nat_s = 1')
    assert parse_faults(text, "f", ALL).fixed[0].kind is kind
    with pytest.raises(FaultError, match=rf"f: line 3: kind '{kind}': this car has no motor"):
        parse_faults(text, "f", TABBYS)


@pytest.mark.parametrize(
    ("kind", "target"),
    [("actuator_stuck", "Throttle"), ("actuator_hot", "Steering"), ("encoder_dead", "Throttle")],
)
def test_where_a_drive_does_it_nothing_is_wired_that_could_break(kind: str, target: str) -> None:
    text = bad(f'kind = "{kind}"\ntarget = "{target}"\nat_s = 1')
    assert len(parse_faults(text, "f", TABBYS).fixed) == 1
    with pytest.raises(FaultError, match=f"f: line 3: target '{target}': this car has a motor dr"):
        parse_faults(text, "f", targets_of(load_vehicle("baja_5b")))
    anywhere = bad(f'kind = "{kind}"\ntarget = "*"\nper_h = 3600')
    plan = parse_faults(anywhere, "f", targets_of(load_vehicle("baja_5b")))
    assert {fault.target for fault in plan.draw(60.0, np.random.default_rng(1))} == {"BrakeServo"}


def test_every_strike_has_targets() -> None:
    assert TARGETS.keys() == set(Strikes)
