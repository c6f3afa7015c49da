"""A motor drive on the bus in place of an ECU's own output: what it is told, and what is wrong.

The ECU's control, limits and safe states stay as they are; here they end in frames to a drive. In
each step the ECU first lets it `hear`, then says what the drive is for, and sends its `frames`; a
drive that was not told anything in a step is released. Its trouble is one of the known codes:

| trouble | code | reason |
|---|---|---|
| the drive is in FAULT or sent an EMCY; it refused a setting | the ECU's own | MOTOR_FAULT |
| told to follow, it is not switched on within 200 ms | the ECU's own | MOTOR_FAULT |
| silent for 60 ms; restarted; not ready: for 1 s, or while driving | ER2 | NODE_SILENT |
| somebody else sends this ECU's commands to it | ER1 | FOREIGN_SENDER |

While it is released, a drive in trouble is reset once a second, or the ECU would never learn that
the cause is gone; the code stays latched as any other. A drive that is released has no torque,
nor has one in FAULT: also the drive that misses its ECU's heartbeat for 150 ms lets its motor go.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from canbus import cia402
from canbus.canopen_protocol import SDO_REQUEST_ID
from canbus.cia402 import OperationMode, StopOption
from canbus.drive_client import (
    RESET_NS,
    SILENCE_NS,
    DriveClient,
    DriveTrouble,
    DriveWish,
    Setting,
)
from canbus.frame import Frame, ReceivedFrame
from dbc.messages import ErrorCode, Reason
from ecus.common.codes import Cause

START_NS: Final = 1_000_000_000
"""Time that a drive is given to be started and set up, from the ECU's first step on."""

RETRY_NS: Final = 1_000_000_000
"""A released drive in trouble is reset this often."""

SWITCH_ON_NS: Final = 200_000_000
"""A drive switches on within 60 ms; one that never does gives no torque (its STO input is open)."""

CALM_NS: Final = 200_000_000
"""A trouble is over when none was seen for so long: a reset hides one for a shorter time."""
assert max(RESET_NS, SILENCE_NS) < CALM_NS < RETRY_NS

COASTS_IN_FAULT: Final = Setting(
    key=cia402.FAULT_REACTION_OPTION, value=StopOption.DISABLE, byte_count=2
)
"""A ramp of the drive's own would work against the brake, or turn the wheel after ER4."""

_ABSENT: Final = frozenset({DriveTrouble.SILENT, DriveTrouble.RESTARTED})


class DriveOutput:
    """One drive as its ECU uses it.

    Args:
        node_id: of the drive.
        own_node_id: of the ECU.
        mode: profile position or profile velocity.
        settings: written whenever the drive announces itself.
        fault_code: what a fault of the drive is to this ECU.

    Attributes:
        acceptance: identifiers the ECU must be given: the drive's and, to notice strangers, the
            ECU's own commands to it.
        client: what is known of the drive.
        trouble: why it is not used, or None.
        is_placed: whether its targets have a meaning; the subclass's word.
    """

    def __init__(
        self,
        node_id: int,
        own_node_id: int,
        mode: OperationMode,
        settings: Sequence[Setting],
        fault_code: ErrorCode,
    ) -> None:
        self.client = DriveClient(node_id, own_node_id, mode, (COASTS_IN_FAULT, *settings))
        targets = (cia402.TARGET_POSITION_ID, cia402.TARGET_VELOCITY_ID, SDO_REQUEST_ID)
        self._commands = frozenset(base + node_id for base in targets)
        self.acceptance = self.client.acceptance | self._commands
        self.trouble: DriveTrouble | None = None
        self.is_placed = True
        self._fault_code = fault_code
        self._wish = DriveWish.RELEASE
        self._target = 0
        self._told = DriveWish.RELEASE
        self._obeyed_ns = 0
        self._due_ns: int | None = None
        self._trouble_ns = 0
        self._retry_ns = 0

    @property
    def is_ready(self) -> bool:
        """Whether it will follow."""
        return self.trouble is None and self.client.is_ready and self.is_placed

    @property
    def is_heard(self) -> bool:
        """Whether what it measures is known."""
        return self.client.is_heard and self.trouble not in _ABSENT

    def hear(
        self, now_ns: int, received: Sequence[ReceivedFrame], *, is_needed: bool
    ) -> list[Cause]:
        """Takes this step's frames in; answers the causes for a code.

        Args:
            now_ns: time of this step.
            received: frames since the last one.
            is_needed: the car drives itself: a drive that is not ready now is in trouble now.
        """
        client = self.client
        client.hear(now_ns, received)
        if self._due_ns is None or (client.is_ready and self.is_placed):
            self._due_ns = now_ns + START_NS
        is_late = now_ns > self._due_ns or (is_needed and not client.is_ready)
        if self._told is not DriveWish.FOLLOW or client.is_following or not client.is_ready:
            self._obeyed_ns = now_ns
        is_off = now_ns - self._obeyed_ns > SWITCH_ON_NS
        if client.trouble is not None or is_late or is_off:
            own_trouble = DriveTrouble.FAULT if is_off else DriveTrouble.SILENT
            self.trouble, self._trouble_ns = client.trouble or own_trouble, now_ns
        elif client.is_ready and now_ns - self._trouble_ns > CALM_NS:
            self.trouble = None
        is_released = self._told is DriveWish.RELEASE
        if client.trouble is not None and is_released and now_ns >= self._retry_ns:
            self._retry_ns = now_ns + RETRY_NS
            client.reset(now_ns)
        return self._causes(now_ns, received)

    def _causes(self, now_ns: int, received: Sequence[ReceivedFrame]) -> list[Cause]:
        causes = []
        if self.trouble in _ABSENT:
            causes.append(Cause(code=ErrorCode.ER2, reason=Reason.NODE_SILENT, seen_ns=now_ns))
        elif self.trouble is not None:
            causes.append(
                Cause(code=self._fault_code, reason=Reason.MOTOR_FAULT, seen_ns=now_ns)
            )
        if any(item.frame.can_id in self._commands for item in received):
            causes.append(Cause(code=ErrorCode.ER1, reason=Reason.FOREIGN_SENDER, seen_ns=now_ns))
        return causes

    def follow(self, target: int) -> None:
        """The drive follows a target in this step: encoder units or rpm."""
        self._wish, self._target = DriveWish.FOLLOW, target

    def stop(self) -> None:
        """The drive brakes its motor in this step and stays there, if it was on."""
        self._wish = DriveWish.STOP

    def frames(self) -> list[Frame]:
        """What is to be sent in this step; without a word before, the motor is let go."""
        self._told, self._wish = self._wish, DriveWish.RELEASE
        return self.client.command(self._told, self._target)
