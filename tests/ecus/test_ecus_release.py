"""Steer, throttle and brake ECU: release, arming, driver input, parameters."""

from __future__ import annotations

from itertools import pairwise

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import ReceivedFrame
from canbus.node import NODE_IDS, EventKind
from dbc.endpoint import SPEC_OF_NAME, Endpoint
from dbc.messages import Mode, NodeState
from tests.ecus.actuator_causes import (
    NAMES,
    SETPOINT,
    nmt,
)
from tests.ecus.ecus_fakes import (
    MS,
    Rig,
    sdo_write,
)

# Release, start, arming ----------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_released_at_boot_until_first_authorised(name: str) -> None:
    rig = Rig(name, started=False)
    rig.mode = None
    rig.steps(20)
    assert rig.state is NodeState.STARTING and rig.is_idle
    rig.mode = Mode.MANUAL
    rig.steps(2)
    assert rig.node.state is NodeState.RELEASED and rig.is_idle
    assert not rig.all_sent("EMERGENCY_BRAKE")


@pytest.mark.parametrize("name", NAMES)
def test_node_that_was_not_started_sends_no_process_data_and_never_moves(name: str) -> None:
    rig = Rig(name, started=False)
    rig.setpoint = SETPOINT[name]
    rig.mode = Mode.READY
    rig.steps(5)
    rig.mode, rig.is_authorised = Mode.AUTOMATIC, True
    rig.steps(20)
    assert rig.state is NodeState.RELEASED and rig.is_idle
    assert not rig.all_sent("STATUS") and not rig.all_sent("DRIVER")


@pytest.mark.parametrize("name", NAMES)
def test_node_restarted_during_automatic_waits_for_re_arming(name: str) -> None:
    rig = Rig(name, started=False)
    rig.mode, rig.is_authorised, rig.setpoint = Mode.AUTOMATIC, True, SETPOINT[name]
    rig.steps(3)
    rig.extra.append(nmt_frame(NmtCommand.START, NODE_IDS[name]))
    rig.steps(30)
    assert rig.state is NodeState.STARTING and rig.is_idle and rig.all_sent("STATUS")
    rig.mode, rig.is_authorised = Mode.READY, False
    rig.steps(2)
    rig.mode, rig.is_authorised = Mode.AUTOMATIC, True
    rig.steps(2)
    assert rig.node.state is NodeState.ACTIVE


@pytest.mark.parametrize("name", NAMES)
def test_arming_is_lost_when_the_node_is_stopped(name: str) -> None:
    rig = Rig(name)
    rig.mode = Mode.READY
    rig.steps(2)
    rig.mode = Mode.AUTOMATIC  # this axis not yet authorised
    rig.steps(2)
    rig.extra.append(nmt_frame(NmtCommand.STOP, NODE_IDS[name]))
    rig.step()
    rig.extra.append(nmt_frame(NmtCommand.START, NODE_IDS[name]))
    rig.step()
    rig.is_authorised = True
    rig.steps(5)
    assert rig.state is NodeState.RELEASED and rig.is_idle


@pytest.mark.parametrize("name", NAMES)
def test_axis_that_is_not_authorised_is_released(name: str) -> None:
    rig = Rig(name).drive(SETPOINT[name])
    rig.is_authorised = False
    rig.step()
    assert rig.state is NodeState.RELEASED and rig.is_idle
    assert not rig.all_sent("EMERGENCY_BRAKE")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("mode", [Mode.INIT, Mode.MANUAL, Mode.READY])
def test_modes_without_authority_never_move_an_actuator(name: str, mode: Mode) -> None:
    rig = Rig(name)
    rig.setpoint = SETPOINT[name]
    rig.mode, rig.is_authorised = mode, True  # even with a key in error
    for _ in range(20):
        rig.step()
        assert rig.is_idle and rig.state is NodeState.RELEASED


@pytest.mark.parametrize("name", NAMES)
def test_active_node_moves_its_actuator(name: str) -> None:
    rig = Rig(name).drive(SETPOINT[name])
    rig.steps(3)
    assert not rig.is_idle
    status = rig.now_sent("STATUS")[-1]
    applied = next(
        getattr(status, field) for field in type(status).__dataclass_fields__ if "applied" in field
    )
    assert applied > 0.0


@pytest.mark.parametrize("name", NAMES)
def test_driver_in_manual_gets_the_control_back_in_the_same_step(name: str) -> None:
    rig = Rig(name).drive(SETPOINT[name])
    rig.mode, rig.is_authorised = Mode.MANUAL, False
    rig.step()
    assert rig.state is NodeState.RELEASED and rig.is_idle


# Driver --------------------------------------------------------------------------------------

TOUCH = {
    "Steering": {"driver_torque_nm": 2.6},
    "Throttle": {"pedal_ratio": 0.06},
    "BrakeServo": {"pedal_ratio": 0.07},
}
NEARLY = {
    "Steering": {"driver_torque_nm": -2.5},
    "Throttle": {"pedal_ratio": 0.05},
    "BrakeServo": {"pedal_ratio": 0.06},
}


@pytest.mark.parametrize("name", NAMES)
def test_driver_input_counts_after_50_ms_and_is_reported_at_once(name: str) -> None:
    rig = Rig(name).drive()
    rig.sense(**TOUCH[name])
    rig.steps(5)  # seen for 40 ms
    assert not rig.node.is_driver_active
    assert not any(driver.driver_active for driver in rig.all_sent("DRIVER"))
    rig.step()
    assert rig.node.is_driver_active
    assert [driver.driver_active for driver in rig.now_sent("DRIVER")] == [True]


@pytest.mark.parametrize("name", NAMES)
def test_driver_input_with_a_gap_starts_again(name: str) -> None:
    rig = Rig(name).drive()
    for _ in range(4):
        rig.sense(**TOUCH[name])
        rig.steps(5)
        rig.heal()
        rig.step()
    assert not any(driver.driver_active for driver in rig.all_sent("DRIVER"))


@pytest.mark.parametrize("name", NAMES)
def test_input_at_the_threshold_is_no_driver(name: str) -> None:
    rig = Rig(name).drive()
    rig.sense(**NEARLY[name])
    rig.steps(20)
    assert not rig.node.is_driver_active


@pytest.mark.parametrize("name", NAMES)
def test_driver_frame_comes_every_20_ms_and_status_every_10(name: str) -> None:
    rig = Rig(name)
    rig.forget()
    rig.steps(40)
    assert len(rig.all_sent("STATUS")) == 40
    driver_id = SPEC_OF_NAME[f"{rig.prefix}_DRIVER"].can_id
    times = [t for t, f in zip(rig.sent_ns, rig.sent, strict=True) if f.can_id == driver_id]
    assert {b - a for a, b in pairwise(times)} == {20 * MS}


@pytest.mark.parametrize("name", NAMES)
def test_driver_frame_comes_at_once_when_the_state_changes(name: str) -> None:
    rig = Rig(name).drive()
    while rig.now_sent("DRIVER"):
        rig.step()
    rig.step()  # a driver frame was due here, so none is due in the next step
    rig.emergency().step()
    assert [d.node_state for d in rig.now_sent("DRIVER")] == [NodeState.EMERGENCY]


@pytest.mark.parametrize("name", NAMES)
def test_status_and_driver_counters_have_no_gap(name: str) -> None:
    rig = Rig(name)
    for message in ("STATUS", "DRIVER"):
        listener = Endpoint("Supervisor", [f"{rig.prefix}_{message}"])
        rig.forget()
        rig.steps(40)
        believed = [
            listener.take([ReceivedFrame(0, frame)])
            for frame in rig.sent
            if frame.can_id == SPEC_OF_NAME[f"{rig.prefix}_{message}"].can_id
        ]
        assert sum(map(bool, believed)) == len(believed) - 1 and not any(listener.counts.values())


# Parameters ----------------------------------------------------------------------------------

PARAMETER = {"Steering": (6, 1000), "Throttle": (7, 400), "BrakeServo": (2, 400)}
"""Sub-index and raw value (thousandths) of the driver's threshold."""
FIELD = {
    "Steering": "driver_torque_nm_max",
    "Throttle": "driver_pedal_ratio_max",
    "BrakeServo": "driver_pedal_ratio_max",
}


@pytest.mark.parametrize("name", NAMES)
def test_parameter_written_in_manual_takes_effect_and_nmt_reset_restores_it(name: str) -> None:
    rig = Rig(name)
    before = getattr(rig.node.params, FIELD[name])
    subindex, raw = PARAMETER[name]
    rig.extra.append(sdo_write(name, subindex, raw))
    rig.step()
    assert getattr(rig.node.params, FIELD[name]) == raw / 1000
    assert rig.logged(EventKind.PARAMETER) == [f"{FIELD[name]} = {raw / 1000:g}"]
    assert [f.data[0] for f in rig.output.frames if f.can_id == 0x580 + NODE_IDS[name]] == [0x60]
    nmt(NmtCommand.RESET_COMMUNICATION)(rig)
    assert getattr(rig.node.params, FIELD[name]) == raw / 1000
    nmt(NmtCommand.RESET_NODE)(rig)
    assert getattr(rig.node.params, FIELD[name]) == before


@pytest.mark.parametrize("name", NAMES)
def test_reset_in_the_step_of_a_write_leaves_the_values_of_the_file(name: str) -> None:
    rig = Rig(name)
    before = rig.node.params
    rig.extra.append(sdo_write(name, *PARAMETER[name]))
    rig.extra.append(nmt_frame(NmtCommand.RESET_NODE, NODE_IDS[name]))
    rig.step()
    assert rig.node.params == before


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("mode", [m for m in Mode if m is not Mode.MANUAL])
def test_parameter_write_out_of_manual_is_refused(name: str, mode: Mode) -> None:
    rig = Rig(name)
    rig.mode = mode
    rig.step()
    before = rig.node.params
    rig.extra.append(sdo_write(name, *PARAMETER[name]))
    rig.step()
    assert rig.node.params == before
    assert [f.data[0] for f in rig.output.frames if f.can_id == 0x580 + NODE_IDS[name]] == [0x80]


@pytest.mark.parametrize("name", NAMES)
def test_written_command_timeout_shortens_the_decision_age(name: str) -> None:
    rig = Rig(name)
    subindex = {"Steering": 7, "Throttle": 8, "BrakeServo": 4}[name]
    rig.extra.append(sdo_write(name, subindex, 60))
    rig.step()
    rig.drive()
    rig.lag_ns, rig.age_ms = 0, 60.0
    rig.steps(6)
    assert rig.state is NodeState.SAFE_ALONE
