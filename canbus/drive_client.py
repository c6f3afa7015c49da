"""A master of one CiA 402 drive that never waits: it may be used inside a node's `step`.

Settings go by SDO when the drive announces itself, everything else by PDO: RPDO 1 or 2 out every
step, TPDO 1 and 2 in. The mappings are those of `dbc/eds/drive.eds`. NMT is not its business: the
supervisor is the only NMT master.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from canbus import canopen_protocol as cia301
from canbus import cia402
from canbus.canopen_protocol import NmtState, SdoAbort, SdoClient
from canbus.cia402 import OperationMode
from canbus.cia402_power import FAULTED, PowerState, state_of
from canbus.frame import Frame, FrameKind, ReceivedFrame

SILENCE_NS: Final = 60_000_000
"""A drive that was heard and is not for so long is lost: three of its slowest PDO."""

HEARTBEAT_LOST_MS: Final = 150
"""Time after which a drive misses its node: three heartbeats of 50 ms."""

RESET_NS: Final = 100_000_000
"""Time that a drive is given to leave FAULT after a reset."""

QUIET_NS: Final = 30_000_000
"""A drive without PDO for so long is not OPERATIONAL: it sends them at least every 20 ms."""

FORGOTTEN_NS: Final = 200_000_000
"""A released drive that shows another mode for so long is not set up: its boot-up was lost."""

_CONSUMER_HEARTBEAT: Final = 0x101601
_COMMAND_PDO_ID: Final = {
    OperationMode.PROFILE_POSITION: cia402.TARGET_POSITION_ID,
    OperationMode.PROFILE_VELOCITY: cia402.TARGET_VELOCITY_ID,
}
_COMMAND: Final = struct.Struct("<Hi")
_POSITION: Final = struct.Struct("<Hib")
_VELOCITY: Final = struct.Struct("<Hih")
_EMERGENCY: Final = struct.Struct("<H6x")
_NEVER_NS: Final = -(1 << 62)

SHUTDOWN: Final = 0x06
SWITCH_ON: Final = 0x07
ENABLE: Final = 0x0F
QUICK_STOP: Final = 0x02
DISABLE_VOLTAGE: Final = 0x00
FAULT_RESET: Final = 0x80


class DriveWish(Enum):
    """What the drive is for in this step."""

    RELEASE = auto()  # no power: the motor coasts
    STOP = auto()  # quick stop
    FOLLOW = auto()  # follow the target, switched on first if need be


class DriveTrouble(Enum):
    """Why a drive is not to be used; the first one stays until `reset`."""

    SILENT = "silent"
    RESTARTED = "restarted"
    FAULT = "fault"
    REFUSED = "a setting refused"


_S, _W = PowerState, DriveWish
CONTROLWORD: Final[dict[DriveWish, dict[PowerState, int]]] = {
    _W.RELEASE: dict.fromkeys(PowerState, DISABLE_VOLTAGE),
    _W.STOP: dict.fromkeys(PowerState, QUICK_STOP),
    _W.FOLLOW: {
        _S.NOT_READY_TO_SWITCH_ON: DISABLE_VOLTAGE,
        _S.SWITCH_ON_DISABLED: SHUTDOWN,
        _S.READY_TO_SWITCH_ON: SWITCH_ON,
        _S.SWITCHED_ON: ENABLE,
        _S.OPERATION_ENABLED: ENABLE,
        _S.QUICK_STOP_ACTIVE: ENABLE,
        _S.FAULT_REACTION_ACTIVE: DISABLE_VOLTAGE,
        _S.FAULT: DISABLE_VOLTAGE,
    },
}
assert all(set(row) == set(PowerState) for row in CONTROLWORD.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One object to write before the drive is used."""

    key: int
    """Index and sub-index in one."""
    value: int
    byte_count: int


class DriveClient:
    """One drive as a node sees it.

    Args:
        node_id: of the drive.
        own_node_id: of the node that steps this client. The drive watches its heartbeat: the node
            that gives targets must not die unnoticed while the supervisor lives.
        mode: profile position (targets in encoder units) or profile velocity (rpm).
        settings: written in this order whenever the drive announces itself, after the heartbeat
            to watch and before the mode.

    Attributes:
        acceptance: identifiers it must be given; others are ignored.
        state: what the newest statusword tells; None before the first.
        position: newest, in encoder units.
        velocity_rpm: newest.
        error_code: of the newest emergency that was no reset; 0 without.
        trouble: why it is not used, or None.
        bad_frames: malformed frames of the drive.

    Raises:
        ValueError: a mode that has no target, or no drive's node id.
    """

    def __init__(
        self,
        node_id: int,
        own_node_id: int,
        mode: OperationMode,
        settings: Sequence[Setting] = (),
    ) -> None:
        if mode not in _COMMAND_PDO_ID:
            raise ValueError(f"mode {mode.name}: a drive follows a position or a velocity")
        if not cia402.DRIVE_NODE_ID_MIN <= node_id <= cia301.NODE_ID_MAX:
            raise ValueError(
                f"drive {node_id}: allowed {cia402.DRIVE_NODE_ID_MIN} to {cia301.NODE_ID_MAX}"
            )
        self.node_id = node_id
        self.mode = mode
        self.acceptance = frozenset(base + node_id for base in cia402.SENT_IDS)
        self.state: PowerState | None = None
        self.position = 0
        self.velocity_rpm = 0
        self.error_code = 0
        self.trouble: DriveTrouble | None = None
        self.bad_frames = 0
        watched = own_node_id << 16 | HEARTBEAT_LOST_MS
        self._settings = [
            Setting(key=_CONSUMER_HEARTBEAT, value=watched, byte_count=4),
            *settings,
            Setting(key=cia402.MODE, value=mode, byte_count=1),
        ]
        self._sdo = SdoClient()
        self._requests: list[Frame] = []
        self._is_asked = False
        self._is_configured = False
        self._has_run = False
        self._wish = DriveWish.RELEASE
        self._mode_shown = OperationMode.NONE.value
        self._known_ns = 0
        self._position_ns = self._velocity_ns = _NEVER_NS
        self._reset_until_ns = _NEVER_NS
        self._resets = False

    @property
    def is_heard(self) -> bool:
        """Whether it has told its position and its velocity."""
        return min(self._position_ns, self._velocity_ns) != _NEVER_NS

    @property
    def is_ready(self) -> bool:
        """Whether FOLLOW is obeyed: set up, heard, in its mode, and nothing wrong."""
        return (
            self.trouble is None
            and self._is_configured
            and self._mode_shown == self.mode
            and self.is_heard
        )

    @property
    def is_following(self) -> bool:
        """Whether the drive moves by our target."""
        return self.is_ready and self.state is PowerState.OPERATION_ENABLED

    def reset(self, now_ns: int) -> None:
        """Forgets the trouble and resets the drive's fault once; what is still wrong comes back."""
        self.trouble = None
        self.error_code = 0
        self._resets = True
        self._reset_until_ns = now_ns + RESET_NS
        if not self._is_configured:
            self._is_asked = False
        if self._position_ns != _NEVER_NS:  # silence is counted anew
            self._position_ns = self._velocity_ns = now_ns

    def step(
        self, now_ns: int, received: Sequence[ReceivedFrame], wish: DriveWish, target: int = 0
    ) -> list[Frame]:
        """`hear` and `command` in one, for whoever knows its wish beforehand."""
        self.hear(now_ns, received)
        return self.command(wish, target)

    def hear(self, now_ns: int, received: Sequence[ReceivedFrame]) -> None:
        """Takes in the drive's frames since the last step and judges it anew."""
        answers: list[Frame] = []
        for item in received:
            if item.frame.can_id in self.acceptance:
                self._take(item, answers)
        self._requests = self._configure(now_ns, answers)
        self._judge(now_ns)

    def command(self, wish: DriveWish, target: int = 0) -> list[Frame]:
        """The frames to send in this step, after `hear`.

        Args:
            wish: FOLLOW becomes STOP while the drive is not ready.
            target: encoder units or rpm; of no effect unless the drive follows.
        """
        self._wish = wish
        frames, self._requests = self._requests, []
        if self._position_ns != _NEVER_NS:  # NMT started it: it hears PDO
            frames += self._command(wish, target)
        return frames

    def _take(self, item: ReceivedFrame, answers: list[Frame]) -> None:
        frame = item.frame
        base, data = frame.can_id - self.node_id, frame.data
        try:
            if frame.kind is not FrameKind.DATA:
                self.bad_frames += 1
            elif base == cia402.POSITION_ID:
                word, self.position, self._mode_shown = _POSITION.unpack(data)
                self.state, self._position_ns = state_of(word), item.arrival_ns
                self._has_run = True
            elif base == cia402.VELOCITY_ID:
                word, self.velocity_rpm, _ = _VELOCITY.unpack(data)
                self.state, self._velocity_ns = state_of(word), item.arrival_ns
            elif base == cia402.EMCY_ID:
                (code,) = _EMERGENCY.unpack(data)
                self.error_code = code or self.error_code
            elif base == cia301.HEARTBEAT_ID:
                self._take_heartbeat(item)
            else:
                answers.append(frame)
        except struct.error:
            self.bad_frames += 1

    def _take_heartbeat(self, item: ReceivedFrame) -> None:
        state = cia301.heartbeat_state(item.frame)
        # Its boot-up was lost; one from before its start may come behind its first PDO.
        is_quiet = item.arrival_ns - self._position_ns > QUIET_NS
        is_back = state is NmtState.PRE_OPERATIONAL and self._has_run and is_quiet
        if state is NmtState.INITIALISING or is_back:  # it has forgotten everything
            if self._is_configured:
                self._note(DriveTrouble.RESTARTED)
            self._is_asked = self._is_configured = self._has_run = False
        if state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL) and not self._is_asked:
            self._is_asked = True
            for setting in self._settings:
                index, subindex = setting.key >> 8, setting.key & 0xFF
                self._sdo.write(self.node_id, index, subindex, setting.value, setting.byte_count)

    def _configure(self, now_ns: int, answers: Sequence[Frame]) -> list[Frame]:
        frames = self._sdo.step(now_ns, answers)
        if self._is_asked and not self._is_configured and not self._sdo.busy:
            results = self._sdo.results.values()
            if any(isinstance(result, SdoAbort) for result in results):
                self._note(DriveTrouble.REFUSED)
            else:
                self._is_configured = True
        return frames

    def _judge(self, now_ns: int) -> None:
        is_resetting = now_ns < self._reset_until_ns
        self._resets = self._resets and is_resetting  # or it would reset a later fault
        if (self.state in FAULTED or self.error_code) and not is_resetting:
            self._note(DriveTrouble.FAULT)
        for heard_ns in (self._position_ns, self._velocity_ns):
            if heard_ns != _NEVER_NS and now_ns - heard_ns > SILENCE_NS:
                self._note(DriveTrouble.SILENT)

        is_strange = self._mode_shown != self.mode and now_ns - self._position_ns <= SILENCE_NS
        if not (is_strange and self._is_configured and self._wish is DriveWish.RELEASE):
            self._known_ns = now_ns
        elif now_ns - self._known_ns > FORGOTTEN_NS:
            self._is_asked = self._is_configured = False

    def _note(self, trouble: DriveTrouble) -> None:
        self.trouble = self.trouble or trouble

    def _command(self, wish: DriveWish, target: int) -> list[Frame]:
        if wish is DriveWish.FOLLOW and not self.is_ready:
            wish = DriveWish.STOP
        word = DISABLE_VOLTAGE if self.state is None else CONTROLWORD[wish][self.state]
        if self._resets and self.state is PowerState.FAULT:
            word, self._resets = FAULT_RESET, False
        is_following = wish is DriveWish.FOLLOW and self.state is PowerState.OPERATION_ENABLED
        if self.mode is OperationMode.PROFILE_VELOCITY:
            return [self._frame(word, target if is_following else 0)]
        if not is_following:
            return [self._frame(word, self.position)]
        handing_over = word | cia402.NEW_SETPOINT | cia402.CHANGE_AT_ONCE
        return [self._frame(handing_over, target), self._frame(word, target)]

    def _frame(self, word: int, target: int) -> Frame:
        return Frame(_COMMAND_PDO_ID[self.mode] + self.node_id, _COMMAND.pack(word, target))
