"""A simulated drive like Maxon's EPOS: a CANopen node of the profile CiA 402 with its motor.

Sans-I/O: `frames = drive.step(now_ns, received)`. Objects, bits and transitions are CiA 402's. That
an EPOS2 has the same option codes and limits, and its gains and filters, are assumptions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Final

from canbus import cia402
from canbus.canopen_protocol import CanopenEvent, NmtCommand
from canbus.cia402 import AbortOption, OperationMode, StopOption
from canbus.cia402_power import (
    POWERED,
    STATE_AFTER,
    STATUSWORD_OF,
    PowerEvent,
    PowerState,
    command_of,
)
from canbus.frame import Frame
from simulation.drives.axis import TICK_S, Axis
from simulation.drives.device import DriveDevice
from simulation.drives.faults import GENERIC, DriveFault
from simulation.drives.homing import Homing
from simulation.drives.modes import Mode, ProfilePosition, ProfileVelocity
from simulation.drives.motor import Motor

TICK_NS: Final = round(TICK_S * 1e9)

REACTION_S_MAX: Final = 5.0
"""A motor that does not come to a standstill by then is let go: its load drives it (assumption)."""

_STAYING: Final = (StopOption.SLOW_DOWN_AND_STAY, StopOption.QUICK_STOP_AND_STAY)
_TURNING: Final = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
_PARTING: Final = (NmtCommand.STOP, NmtCommand.RESET_COMMUNICATION)
_BRAKING: Final = (PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION_ACTIVE)


class EposDrive:
    """One drive on the bus, and the motor that it turns.

    Args:
        node_id: 0x11 and up in this project.
        motor: what it turns; the caller may change its load between steps.

    Attributes:
        state: where the power state machine is.
        acceptance: identifiers it wants; others may be left out.
    """

    def __init__(self, node_id: int, motor: Motor) -> None:
        params = motor.params
        rated_ma = round(1000.0 * params.current_rated_a)
        self.motor = motor
        self.state = PowerState.NOT_READY_TO_SWITCH_ON
        self._controlword = 0
        self._broken: set[DriveFault] = set()
        self._told: set[DriveFault] = set()
        self._register = 0
        self._now_ns = 0
        self._next_tick_ns: int | None = None
        self._braked_s = 0.0
        self._can_brake = True
        self._device = DriveDevice(
            node_id,
            {
                cia402.CURRENT_RATED: rated_ma,
                cia402.CURRENT_MAX: round(1e6 * params.current_a_max / rated_ma),
            },
            self._obey_controlword,
        )
        self._axis = axis = Axis(motor, self._device.values)
        self._modes: dict[OperationMode, Mode] = {
            OperationMode.PROFILE_POSITION: ProfilePosition(axis),
            OperationMode.PROFILE_VELOCITY: ProfileVelocity(axis),
            OperationMode.HOMING: Homing(axis),
        }
        self._mode: Mode | None = None

    @property
    def acceptance(self) -> frozenset[int]:
        """Identifiers it wants now; mappings may change them."""
        return self._device.acceptance

    @property
    def bad_frames(self) -> int:
        """Frames to it that were malformed, and values in PDO that it refused."""
        return self._device.bad_frames + self._device.bad_pdos

    @property
    def values(self) -> Mapping[int, int]:
        """The objects' numbers by index and sub-index in one, from 1400 on: a live view."""
        return MappingProxyType(self._device.values)

    def fail(self, fault: DriveFault) -> None:
        """Breaks something, from the next tick on, until `mend`."""
        self._broken.add(fault)
        self.motor.is_encoder_broken = DriveFault.ENCODER in self._broken

    def mend(self, fault: DriveFault) -> None:
        """Takes a cause away; the drive stays in FAULT until it is reset."""
        self._broken.discard(fault)
        self.motor.is_encoder_broken = DriveFault.ENCODER in self._broken

    def step(self, now_ns: int, received: Iterable[Frame] = ()) -> list[Frame]:
        """Takes in what came since the last step, moves the motor up to now, returns its frames.

        The first step sends the boot-up. Loops and motor go in ticks of 1 ms of `now_ns`.
        """
        self._now_ns = now_ns
        frames = self._device.receive(now_ns, received)
        for event in self._device.poll_events():
            self._obey_nmt(event)
        if self._device.is_master_lost(now_ns):
            self._lose_master()
        if self._next_tick_ns is None:
            self._next_tick_ns = now_ns + TICK_NS
            self._change(PowerEvent.INITIALISED)
        while self._next_tick_ns <= now_ns:
            self._tick()
            self._next_tick_ns += TICK_NS
        self._tell()
        return frames + self._device.send(now_ns)

    # Commands

    def _obey_controlword(self) -> None:
        """The master wrote an object of the profile."""
        values = self._device.values
        self._choose_mode(OperationMode(values[cia402.MODE]))
        before, self._controlword = self._controlword, values[cia402.CONTROLWORD]
        command = command_of(self._controlword, before)
        if command is PowerEvent.FAULT_RESET:
            self._reset_fault()
        elif command is not None:
            if command is PowerEvent.ENABLE_OPERATION and not self._may_resume:
                return
            self._change(command)
            self._change(command)  # READY_TO_SWITCH_ON takes two to OPERATION_ENABLED
        if self.state is PowerState.OPERATION_ENABLED and self._mode is not None:
            self._mode.command(self._controlword, before)

    @property
    def _may_resume(self) -> bool:
        """Transition 16 is for option codes that stay in the quick stop."""
        option = self._device.values[cia402.QUICK_STOP_OPTION]
        return self.state is not PowerState.QUICK_STOP_ACTIVE or option in _STAYING

    def _choose_mode(self, wanted: OperationMode) -> None:
        values = self._device.values
        if values[cia402.MODE_DISPLAY] == wanted:
            return
        values[cia402.MODE_DISPLAY] = wanted
        self._mode = self._modes.get(wanted)
        self._begin_mode()

    def _begin_mode(self) -> None:
        self._axis.start()
        if self._mode is not None:
            self._mode.start()

    def _change(self, event: PowerEvent) -> None:
        """One step of the power state machine, with what goes with entering a state."""
        before, self.state = self.state, STATE_AFTER[self.state][event]
        if self.state is before:
            return
        if self.state is PowerState.OPERATION_ENABLED:
            self._begin_mode()
        elif self.state in _BRAKING:
            self._braked_s = 0.0
            # who carries no current cannot be braked
            self._can_brake = self._can_brake and before in _TURNING

    def _obey_nmt(self, event: CanopenEvent) -> None:
        """Stop and resets are a lost master to a motor that runs (CiA 402-2, object 6007)."""
        if event.command is NmtCommand.RESET_NODE:
            self.state = PowerState.SWITCH_ON_DISABLED
            self._controlword = self._register = 0
            self._mode = None
            self._told.clear()
        elif self.state in _TURNING and event.command in _PARTING:
            self._lose_master()

    def _lose_master(self) -> None:
        option = self._device.values[cia402.ABORT_CONNECTION_OPTION]
        if option == AbortOption.FAULT:
            self._trip(DriveFault.HEARTBEAT)
            return
        self._report(DriveFault.HEARTBEAT)
        if option == AbortOption.DISABLE_VOLTAGE:
            self._change(PowerEvent.DISABLE_VOLTAGE)
        elif option == AbortOption.QUICK_STOP:
            self._change(PowerEvent.QUICK_STOP)

    # Faults

    def _trip(self, fault: DriveFault) -> None:
        self._report(fault)
        if not fault.value.is_controllable:
            self._can_brake = False
        self._change(PowerEvent.FAULT)

    def _report(self, fault: DriveFault) -> None:
        kind = fault.value
        self._told.add(fault)
        self._register |= kind.register | GENERIC
        self._device.values[cia402.ERROR_CODE] = kind.error_code
        self._device.emergency(self._now_ns, kind.error_code, self._register)

    def _reset_fault(self) -> None:
        """Rising edge of bit 7: heard in FAULT alone, and with every cause gone."""
        if self.state is PowerState.FAULT and not self._broken:
            self._change(PowerEvent.FAULT_RESET)
            self._told.clear()
            self._register = self._device.values[cia402.ERROR_CODE] = 0
            self._device.emergency(self._now_ns, 0, 0)

    # Motion

    def _tick(self) -> None:
        axis = self._axis
        axis.measure()
        if self._broken - self._told:
            for fault in DriveFault:
                if fault in self._broken and fault not in self._told:
                    self._trip(fault)
        if self.state is PowerState.OPERATION_ENABLED and self._mode is not None:
            self._mode.tick(self._controlword)
            axis.drive(holds_position=self._mode.holds_position, limit_a=self._mode.limit_a)
            window = self._device.values[cia402.FOLLOWING_ERROR_WINDOW]
            if self._mode.holds_position and abs(axis.following_error) > window:
                self._trip(DriveFault.FOLLOWING_ERROR)
        elif self.state in _BRAKING:
            self._brake()
        else:
            self._can_brake = True
            axis.coast()

    def _brake(self) -> None:
        """Quick stop and fault reaction: the ramp of the option code, then what follows it."""
        axis, values = self._axis, self._device.values
        is_fault = self.state is PowerState.FAULT_REACTION_ACTIVE
        key = cia402.FAULT_REACTION_OPTION if is_fault else cia402.QUICK_STOP_OPTION
        option = values[key]
        ended = PowerEvent.REACTION_ENDED if is_fault else PowerEvent.STOPPED
        if option == StopOption.DISABLE or not self._can_brake:
            self._change(ended)
            axis.coast()
            return
        axis.stop(option)
        holds = self._mode is not None and self._mode.holds_position and not is_fault
        axis.drive(holds_position=holds, limit_a=float("inf"))
        self._braked_s += TICK_S
        is_over = axis.reference.velocity == 0.0 and axis.is_standing
        if (is_over or self._braked_s > REACTION_S_MAX) and option not in _STAYING:
            self._change(ended)

    def _tell(self) -> None:
        """Puts what is measured into the objects."""
        axis, values = self._axis, self._device.values
        word = STATUSWORD_OF[self.state] | cia402.REMOTE
        if self.state in POWERED:
            word |= cia402.VOLTAGE_ENABLED
        if self.state is PowerState.OPERATION_ENABLED and self._mode is not None:
            word |= self._mode.status()
        rated_a = values[cia402.CURRENT_RATED] * 0.001
        values[cia402.STATUSWORD] = word
        values[cia402.POSITION_ACTUAL] = _wrapped(axis.position)
        values[cia402.VELOCITY_ACTUAL] = round(axis.velocity_rpm)
        values[cia402.POSITION_DEMAND] = _wrapped(round(axis.reference.position))
        values[cia402.VELOCITY_DEMAND] = round(axis.reference_rpm)
        values[cia402.CURRENT_ACTUAL] = round(1000.0 * axis.motor.current_a / rated_a)


def _wrapped(position: int) -> int:
    """As a counter of 32 bits holds it; at 3000 rpm it overflows after three hours."""
    return (position + (1 << 31)) % (1 << 32) - (1 << 31)
