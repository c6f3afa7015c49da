"""The supervisor through its steps: power-on, leaving AUTOMATIC, emergency stop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from canbus.canopen_protocol import NmtCommand
from canbus.frame import Frame
from canbus.node import NODE_IDS, EventKind
from dbc.endpoint import FAILSAFE_ID
from dbc.messages import ErrorCode, HeartbeatState, Inhibit, Mode, NodeState, Reason, Request
from ecus.supervisor.mode import RELAY_CLOSED
from tests.ecus.ecus_fakes import sdo_write
from tests.ecus.supervisor_fakes import NODES, Street

ACTUATORS = ("Steering", "Throttle", "BrakeServo")
SUFFIX = {
    "Steering": "STEERING", "Throttle": "THROTTLE", "BrakeServo": "BRAKE_SERVO",
    "SafetyMonitor": "SAFETY_MONITOR", "Gateway": "GATEWAY",
}


# Power-on ------------------------------------------------------------------------------------


def test_power_on_leads_from_init_to_manual_when_all_actuator_nodes_are_heard() -> None:
    street = Street(booted=False)
    street.until(Mode.MANUAL, 60)
    assert street.modes[0] is Mode.INIT and set(street.modes) == {Mode.INIT, Mode.MANUAL}


@pytest.mark.parametrize("name", ACTUATORS)
def test_init_waits_for_every_actuator_node_and_says_for_which(name: str) -> None:
    street = Street(booted=False)
    street.nodes[name].is_silent = True
    state = street.steps(100)
    assert state.mode is Mode.INIT and state.inhibit is Inhibit[f"MISSING_{SUFFIX[name]}"]
    street.nodes[name].is_silent = False
    street.until(Mode.MANUAL)


def test_relay_found_closed_at_power_on_is_an_emergency_that_was_never_reset() -> None:
    street = Street(booted=False)
    street.relay = True
    assert street.step().mode is Mode.EMERGENCY and 1 in street.codes
    assert [brake.reason for brake in street.brakes()] == [Reason.ADOPTED]
    street.steps(60)
    assert street.relay is True and set(street.modes) == {Mode.EMERGENCY}


def test_init_waits_for_the_relays_contact_to_be_read() -> None:
    street = Street(booted=False)
    street.relay = None
    street.steps(100)
    assert set(street.modes) == {Mode.INIT} and street.relay is None
    street.relay = False
    street.until(Mode.MANUAL)


def test_relay_matters_at_power_on_alone() -> None:
    street = Street()
    street.relay = True
    street.steps(20)
    assert set(street.modes) == {Mode.MANUAL} and not street.brakes()


@pytest.mark.parametrize("name", ["SafetyMonitor", "Gateway"])
def test_dead_laptop_does_not_keep_the_car_from_manual(name: str) -> None:
    street = Street(booted=False)
    street.nodes[name].is_silent = True
    street.until(Mode.MANUAL, 60)
    assert street.steps(50).inhibit is Inhibit[f"MISSING_{SUFFIX[name]}"]


def test_init_with_everybody_there_says_that_it_is_starting() -> None:
    street = Street(booted=False)
    street.step()
    assert street.shown.inhibit is Inhibit.NOT_OPERATIONAL_STEERING
    for node in street.nodes.values():
        node.state, node.is_obedient = NodeState.ACTIVE, False
    assert street.steps(60).inhibit is Inhibit.STARTING


def test_relay_follows_the_mode_and_init_leaves_it_alone() -> None:
    street = Street(booted=False)
    for _ in range(60):
        street.step()
        assert street.output.actuator.automatic_relay_closed == RELAY_CLOSED[street.mode]
    assert street.mode is Mode.MANUAL
    street.automatic()
    assert street.output.actuator.automatic_relay_closed is True


def test_supervisor_starts_itself_and_then_every_node_once() -> None:
    street = Street(booted=False)
    street.steps(60)
    starts = [frame.data for frame in street.sent if frame.can_id == 0x000]
    assert starts == [bytes([NmtCommand.START, NODE_IDS[name]]) for name in NODES]
    assert street.ecu.shell.is_operational


def test_node_that_does_not_start_is_told_again_every_200_ms() -> None:
    street = Street()
    street.nodes["Gateway"].nmt = HeartbeatState.STOPPED
    street._hear = lambda frames: None  # type: ignore[method-assign]
    street.steps(100)
    starts = [frame for frame in street.sent if frame.can_id == 0x000]
    assert 4 <= len(starts) <= 5 and {frame.data for frame in starts} == {b"\x01\x06"}


def test_no_node_is_started_while_the_car_drives_itself() -> None:
    street = Street().automatic()
    street.nodes["Gateway"].nmt = HeartbeatState.PRE_OPERATIONAL
    while street.mode is Mode.AUTOMATIC:
        assert not [frame for frame in street.output.frames if frame.can_id == 0x000]
        street.step()


def test_stranger_cannot_stop_the_nmt_master() -> None:
    street = Street()
    street.extra.append(Frame(0x000, bytes([NmtCommand.STOP, 0])))
    street.step()
    assert street.ecu.shell.is_operational
    assert street.logged(EventKind.FOREIGN) == ["000#0200 (data)"]
    assert street.shown.inhibit is Inhibit.FOREIGN_FRAME


# Leaving AUTOMATIC ---------------------------------------------------------------------------


@pytest.mark.parametrize("by", ["button", "disengage"])
@pytest.mark.parametrize("speed_mps", [0.0, 4.0])
def test_button_or_disengage_stops_first_and_then_gives_ready(by: str, speed_mps: float) -> None:
    street = Street()
    street.speed_mps = speed_mps
    street.automatic().steps(40)
    street.forget()
    if by == "button":
        street.push()
    else:
        street.ask(Request.DISENGAGE).steps(6)
    assert Mode.STOPPING in street.modes
    if speed_mps:
        street.steps(100)
        assert street.mode is Mode.STOPPING
        while street.speed_mps > 0.15:  # as fast as tyres can
            street.speed_mps -= 0.05
            street.step()
        street.speed_mps = 0.0
        assert street.until(Mode.READY, 40) >= 29  # 0.3 s of standstill
    assert street.mode is Mode.READY
    assert street.logged(EventKind.CODE) == [] and not street.brakes()


@pytest.mark.parametrize(("front", "rear"), [(0.0, 3.0), (3.0, 0.0)])
def test_standstill_needs_both_axles(front: float, rear: float) -> None:
    street = Street().automatic()
    street.speed_mps, street.rear_speed_mps = front, rear
    street.steps(40)
    street.push()
    street.steps(100)
    assert street.mode is Mode.STOPPING


@pytest.mark.parametrize("name", ACTUATORS)
@pytest.mark.parametrize("stop", [False, True])
def test_driver_takes_over_within_one_step_from_each_control(name: str, stop: bool) -> None:
    street = Street()
    street.speed_mps = 5.0
    street.automatic()
    if stop:
        street.push()
        assert street.mode is Mode.STOPPING
    street.forget()
    while street.cycle % 2 == 0:  # no driver frame is due in the next step
        street.step()
    street.nodes[name].is_driver_active = True
    street.extra.append(street.driver_frame(name))
    state = street.step()
    assert state.mode is Mode.MANUAL
    assert not (state.steering_authorised or state.throttle_authorised or state.brake_authorised)
    assert street.output.actuator.automatic_relay_closed is False and not street.brakes()


@pytest.mark.parametrize("name", ACTUATORS)
def test_driver_input_in_ready_gives_manual(name: str) -> None:
    street = Street().ready()
    street.nodes[name].is_driver_active = True
    street.until(Mode.MANUAL, 2)


# Emergency stop and FAILSAFE -----------------------------------------------------------------


def _stop(street: Street, how: str) -> None:
    if how == "FAILSAFE":
        street.extra.append(Frame(FAILSAFE_ID))
    else:
        street.is_stop_pressed = True


@pytest.mark.parametrize("how", ["FAILSAFE", "input"])
@pytest.mark.parametrize("scene", ["ready", "automatic", "stopping"])
def test_emergency_stop_brakes_out_of_ready_and_driving(how: str, scene: str) -> None:
    street = Street()
    if scene == "stopping":
        street.speed_mps = 4.0
        street.automatic()
        street.push()
        assert street.mode is Mode.STOPPING
    else:
        getattr(street, scene)()
    _stop(street, how)
    state = street.step()
    assert state.mode is Mode.EMERGENCY
    (brake,) = street.brakes()
    assert brake.code is ErrorCode.ER1
    assert brake.reason.name == ("FAILSAFE_FRAME" if how == "FAILSAFE" else "EMERGENCY_STOP_INPUT")
    assert state.brake_authorised and not state.throttle_authorised and state.er1


@pytest.mark.parametrize("how", ["FAILSAFE", "input"])
def test_emergency_stop_never_brakes_in_manual_or_init(how: str) -> None:
    manual = Street()
    _stop(manual, how)
    manual.steps(20)
    assert set(manual.modes) == {Mode.MANUAL} and not manual.brakes()
    assert 1 in manual.codes and manual.shown.inhibit is Inhibit.EMERGENCY_STOP_PRESSED
    init = Street(booted=False)
    for _ in range(60):
        _stop(init, how)
        init.step()
    assert set(init.modes) == {Mode.INIT} and not init.brakes()


def test_bad_frame_in_the_step_of_an_emergency_stop_is_not_its_cause() -> None:
    street = Street().ready()
    street.extra += [Frame(0x185, b"\x01"), Frame(FAILSAFE_ID)]
    street.step()
    (brake,) = street.brakes()
    assert brake.code is ErrorCode.ER1


# Parameters ----------------------------------------------------------------------------------


def test_parameter_written_in_manual_takes_effect() -> None:
    street = Street()
    street.extra.append(sdo_write("Supervisor", 2, 1000))
    street.step()
    assert street.ecu.params.engage_speed_mps_max == 1.0
    street.speed_mps = 2.0
    street.push()
    assert street.ask(Request.ENGAGE).steps(10).inhibit is Inhibit.TOO_FAST


def test_parameter_write_out_of_manual_is_refused() -> None:
    street = Street().ready()
    before = replace(street.ecu.params)
    street.extra.append(sdo_write("Supervisor", 2, 1000))
    street.step()
    assert street.ecu.params == before
    refused: list[Any] = [f.data[0] for f in street.output.frames if f.can_id == 0x581]
    assert refused == [0x80]
