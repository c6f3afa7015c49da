"""A simulated drive and whoever speaks to it, in virtual time."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

from canbus import cia402
from canbus.canopen_protocol import NmtCommand, NmtState, nmt_frame
from canbus.cia402_power import PowerState, state_of
from canbus.frame import Frame
from simulation.drives.drive import EposDrive
from simulation.drives.motor import EC45, Motor, MotorParams

MS = 1_000_000
NODE_ID = 0x11
MASTER_ID = 1

SHUTDOWN, SWITCH_ON, ENABLE = 0x06, 0x07, 0x0F
QUICK_STOP, DISABLE_VOLTAGE, FAULT_RESET = 0x02, 0x00, 0x80
_WIDTH_COMMAND = {1: 0x2F, 2: 0x2B, 4: 0x23}


class Rig:
    """A drive that is stepped every millisecond, and hands for its master."""

    def __init__(
        self, params: MotorParams = EC45, *, angle_rad: float = 0.0, period_ns: int = MS
    ) -> None:
        self.motor = Motor(params, angle_rad=angle_rad)
        self.drive = EposDrive(NODE_ID, self.motor)
        self.now_ns = 0
        self.seen: list[tuple[int, Frame]] = []
        self._period_ns = period_ns
        self._waiting: list[Frame] = []
        self.run(1)

    def send(self, *frames: Frame) -> None:
        """Frames that arrive with the next step."""
        self._waiting += frames

    def run(self, duration_ms: int, each_step: Callable[[], None] = lambda: None) -> list[Frame]:
        """Passes time; the frames that the drive sent in it."""
        first = len(self.seen)
        for _ in range(duration_ms * MS // self._period_ns):
            self.now_ns += self._period_ns
            received, self._waiting = self._waiting, []
            for frame in self.drive.step(self.now_ns, received):
                self.seen.append((self.now_ns, frame))
            each_step()
        return [frame for _, frame in self.seen[first:]]

    def ask(self, data: bytes) -> bytes:
        """One SDO request and its answer."""
        self.send(Frame(0x600 + NODE_ID, data))
        (answer,) = [f.data for f in self.run(1) if f.can_id == 0x580 + NODE_ID]
        return answer

    def write(self, key: int, value: int, width: int) -> int:
        """Writes an object; 0 or the abort code."""
        head = struct.pack("<BHB", _WIDTH_COMMAND[width], key >> 8, key & 0xFF)
        body = value.to_bytes(width, "little", signed=value < 0).ljust(4, b"\0")
        answer = self.ask(head + body)
        return struct.unpack("<L", answer[4:])[0] if answer[0] == 0x80 else 0

    def read(self, key: int, width: int, *, signed: bool = True) -> int:
        """Reads an object of at most four bytes."""
        answer = self.ask(struct.pack("<BHBL", 0x40, key >> 8, key & 0xFF, 0))
        assert answer[0] != 0x80, answer.hex()
        return int.from_bytes(answer[4 : 4 + width], "little", signed=signed)

    def start(self, mode: cia402.OperationMode = cia402.OperationMode.NONE) -> None:
        """NMT start, and a mode."""
        self.send(nmt_frame(NmtCommand.START, NODE_ID))
        self.run(1)
        if mode:
            assert self.write(cia402.MODE, mode, 1) == 0

    def command(self, controlword: int, target: int | None = None, *, pdo: int = 1) -> None:
        """RPDO 1 (target position) or 2 (target velocity); None: the target as it is."""
        key = cia402.TARGET_POSITION if pdo == 1 else cia402.TARGET_VELOCITY
        value = self.drive.values[key] if target is None else target
        can_id = 0x200 + (pdo - 1) * 0x100 + NODE_ID
        self.send(Frame(can_id, struct.pack("<Hi", controlword, value)))
        self.run(1)

    def enable(self, mode: cia402.OperationMode) -> None:
        """All the way to OPERATION ENABLED."""
        self.start(mode)
        self.command(SHUTDOWN)
        self.command(ENABLE)
        assert self.state is PowerState.OPERATION_ENABLED

    @property
    def state(self) -> PowerState | None:
        """What the statusword tells."""
        return state_of(self.drive.values[cia402.STATUSWORD])

    def has(self, bits: int) -> bool:
        """Whether all these bits of the statusword are set."""
        return self.drive.values[cia402.STATUSWORD] & bits == bits

    def heartbeat(self) -> Frame:
        """One of the master's."""
        return Frame(0x700 + MASTER_ID, bytes((NmtState.OPERATIONAL,)))

    def emergencies(self) -> Iterator[tuple[int, int, int]]:
        """Time, error code and register of each EMCY so far."""
        for now_ns, frame in self.seen:
            if frame.can_id == 0x80 + NODE_ID:
                code, register = struct.unpack_from("<HB", frame.data)
                yield now_ns, code, register
