"""The power state machine: every cell by hand and beside canopen's own table; the controlword."""

from __future__ import annotations

import itertools

import pytest
from canopen.profiles.p402 import State402

from canbus import cia402
from canbus.cia402 import OperationMode
from canbus.cia402_power import (
    STATE_AFTER,
    STATUSWORD_OF,
    PowerEvent,
    PowerState,
    command_of,
    state_of,
)
from canbus.frame import Frame
from simulation.drives.faults import DriveFault
from tests.simulation.drive_rig import (
    DISABLE_VOLTAGE,
    ENABLE,
    FAULT_RESET,
    NODE_ID,
    QUICK_STOP,
    SHUTDOWN,
    SWITCH_ON,
    Rig,
)

S, E = PowerState, PowerEvent

# Written a second time by hand: the numbered transitions of CiA 402-2, and nothing else.
TRANSITIONS = {
    (S.NOT_READY_TO_SWITCH_ON, E.INITIALISED): S.SWITCH_ON_DISABLED,
    (S.SWITCH_ON_DISABLED, E.SHUTDOWN): S.READY_TO_SWITCH_ON,
    (S.READY_TO_SWITCH_ON, E.SWITCH_ON): S.SWITCHED_ON,
    (S.READY_TO_SWITCH_ON, E.ENABLE_OPERATION): S.SWITCHED_ON,
    (S.READY_TO_SWITCH_ON, E.DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.READY_TO_SWITCH_ON, E.QUICK_STOP): S.SWITCH_ON_DISABLED,
    (S.SWITCHED_ON, E.ENABLE_OPERATION): S.OPERATION_ENABLED,
    (S.SWITCHED_ON, E.SHUTDOWN): S.READY_TO_SWITCH_ON,
    (S.SWITCHED_ON, E.DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.SWITCHED_ON, E.QUICK_STOP): S.SWITCH_ON_DISABLED,
    (S.OPERATION_ENABLED, E.SWITCH_ON): S.SWITCHED_ON,
    (S.OPERATION_ENABLED, E.SHUTDOWN): S.READY_TO_SWITCH_ON,
    (S.OPERATION_ENABLED, E.DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.OPERATION_ENABLED, E.QUICK_STOP): S.QUICK_STOP_ACTIVE,
    (S.QUICK_STOP_ACTIVE, E.DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.QUICK_STOP_ACTIVE, E.STOPPED): S.SWITCH_ON_DISABLED,
    (S.QUICK_STOP_ACTIVE, E.ENABLE_OPERATION): S.OPERATION_ENABLED,
    (S.FAULT_REACTION_ACTIVE, E.REACTION_ENDED): S.FAULT,
    (S.FAULT, E.FAULT_RESET): S.SWITCH_ON_DISABLED,
} | {(state, E.FAULT): S.FAULT_REACTION_ACTIVE for state in PowerState if state is not S.FAULT}

CONTROLWORDS = {
    E.SHUTDOWN: SHUTDOWN,
    E.SWITCH_ON: SWITCH_ON,
    E.ENABLE_OPERATION: ENABLE,
    E.DISABLE_VOLTAGE: DISABLE_VOLTAGE,
    E.QUICK_STOP: QUICK_STOP,
    E.FAULT_RESET: FAULT_RESET,
}


def canopen_name(state: PowerState) -> str:
    return state.name.replace("_", " ")


@pytest.mark.parametrize("state", PowerState)
@pytest.mark.parametrize("event", PowerEvent)
def test_every_cell_of_the_table_is_cia_402s(state: PowerState, event: PowerEvent) -> None:
    assert STATE_AFTER[state][event] is TRANSITIONS.get((state, event), state)


def test_what_canopen_expects_of_a_controlword_the_table_does() -> None:
    checked = 0
    for (before, after), controlword in State402.TRANSITIONTABLE.items():
        if before == "START" or before in ("NOT READY TO SWITCH ON", "FAULT REACTION ACTIVE"):
            continue  # automatic transitions
        command = command_of(controlword, 0)
        assert command is not None
        state = PowerState[before.replace(" ", "_")]
        assert canopen_name(STATE_AFTER[state][command]) == after
        checked += 1
    assert checked == 13


@pytest.mark.parametrize("state", PowerState)
def test_a_statusword_reads_as_its_state_here_and_in_canopen(state: PowerState) -> None:
    word = STATUSWORD_OF[state]
    for others in (0, 0xFF90):
        assert state_of(word | others) is state
        mask, bits = State402.SW_MASK[canopen_name(state)]
        assert (word | others) & mask == bits
    assert [
        name for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits
    ] == [canopen_name(state)]


def test_no_statusword_reads_as_a_state_that_canopen_does_not_see() -> None:
    for word in range(0x80):
        seen = {name for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits}
        state = state_of(word)
        assert seen == (set() if state is None else {canopen_name(state)}), hex(word)


def test_every_controlword_is_one_command_and_a_fault_reset_rises() -> None:
    for word, before in itertools.product(range(0x100), (0x00, 0x80)):
        command = command_of(word, before)
        if word & 0x80:
            assert command is (E.FAULT_RESET if not before else None)
        elif not word & 0x02:
            assert command is E.DISABLE_VOLTAGE
        elif not word & 0x04:
            assert command is E.QUICK_STOP
        else:
            by_low_bits = {0x6: E.SHUTDOWN, 0xE: E.SHUTDOWN, 0x7: E.SWITCH_ON}
            assert command is by_low_bits.get(word & 0x0F, E.ENABLE_OPERATION)


def reach(rig: Rig, state: PowerState) -> None:
    """Brings a drive into a state as a master would."""
    rig.start(OperationMode.PROFILE_VELOCITY)
    if state in (S.FAULT_REACTION_ACTIVE, S.QUICK_STOP_ACTIVE):  # states that take a moving motor
        rig.command(SHUTDOWN, 0, pdo=2)
        rig.command(ENABLE, 1000, pdo=2)
        rig.run(500)
        if state is S.QUICK_STOP_ACTIVE:
            rig.command(QUICK_STOP, pdo=2)
        else:
            rig.drive.fail(DriveFault.OVERTEMPERATURE)
            rig.run(1)
    elif state is S.FAULT:
        rig.drive.fail(DriveFault.OVERTEMPERATURE)
        rig.run(2)
        rig.drive.mend(DriveFault.OVERTEMPERATURE)
    else:
        words = {
            S.SWITCH_ON_DISABLED: (),
            S.READY_TO_SWITCH_ON: (SHUTDOWN,),
            S.SWITCHED_ON: (SHUTDOWN, SWITCH_ON),
            S.OPERATION_ENABLED: (SHUTDOWN, SWITCH_ON, ENABLE),
        }
        for word in words[state]:
            rig.command(word, 0, pdo=2)
    assert rig.state is state


@pytest.mark.parametrize("state", [state for state in S if state is not S.NOT_READY_TO_SWITCH_ON])
@pytest.mark.parametrize("event", CONTROLWORDS)
def test_a_drive_on_the_bus_goes_the_ways_of_the_table(
    state: PowerState, event: PowerEvent
) -> None:
    rig = Rig()
    reach(rig, state)
    rig.command(CONTROLWORDS[event], pdo=2)
    expected = TRANSITIONS.get((state, event), state)
    if event is E.ENABLE_OPERATION and expected is S.SWITCHED_ON:
        expected = S.OPERATION_ENABLED  # transition 4 follows 3, the command still stands
    assert rig.state is expected
    assert rig.drive.state is expected


def test_first_step_initialises_and_announces_the_drive() -> None:
    rig = Rig()
    assert [frame for _, frame in rig.seen] == [Frame(0x700 + NODE_ID, b"\0")]
    assert rig.state is S.SWITCH_ON_DISABLED
    assert rig.has(cia402.REMOTE)
    assert not rig.has(cia402.VOLTAGE_ENABLED)


def test_voltage_is_told_where_the_power_stage_has_it() -> None:
    rig = Rig()
    rig.start()
    for word, powered in ((SHUTDOWN, False), (SWITCH_ON, True), (ENABLE, True), (0, False)):
        rig.command(word)
        assert rig.has(cia402.VOLTAGE_ENABLED) is powered


def test_a_drive_without_power_lets_the_motor_turn() -> None:
    rig = Rig()
    rig.start(OperationMode.PROFILE_VELOCITY)
    for word in (SHUTDOWN, SWITCH_ON):
        rig.command(word, 3000, pdo=2)
        rig.run(100)
        assert rig.motor.current_a == 0.0
    rig.motor.load_torque_nm = 0.02
    rig.run(100)
    assert rig.motor.speed_radps > 1.0
