"""Three drives on one simulated CAN bus, and the two nodes that command them.

The nodes tell their drives a value each by `canbus/drive_client.py` every 10 ms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from canbus.canopen_protocol import HEARTBEAT_ID, NmtCommand, NmtState, nmt_frame
from canbus.cia402 import OperationMode
from canbus.drive_client import DriveClient, DriveWish, Setting
from canbus.frame import Frame, ReceivedFrame
from canbus.node import NODE_IDS, PERIOD_NS
from experiments.unicamp.plant import BAJA
from simulation.drives.drive import EposDrive
from simulation.drives.motor import Motor
from simulation.kernel import Action, Kernel
from simulation.wire import Receiver, Wire

STEER, LEFT, RIGHT = 0x11, 0x12, 0x13
DRIVE_PERIOD_NS: Final = 5_000_000
"""The drives hear the bus so often; their loops go every millisecond of it."""
HEARTBEAT_NS: Final = 50_000_000
BOOT_S: Final = 0.3
ENABLE_S: Final = 0.2
NODE_PRIORITY, DRIVE_PRIORITY, PLANT_PRIORITY, DRIVER_PRIORITY = 1, 2, 3, 4
"""Of what happens at one instant: who decides comes last, so nothing is known before its time."""

Step = Callable[[int, list[ReceivedFrame]], list[Frame]]
NO_SETTINGS: Final[Mapping[int, tuple[Setting, ...]]] = {}


class DriveBus:
    """The bus and everybody on it; nothing is enabled before `start`.

    Args:
        motors: By node id.
        settings: What the nodes write into their drives first, by node id.
        drive_period_ns: Between two looks of the drives at the bus.

    Attributes:
        drives, clients: By node id.
        values: What each drive is told, by node id: encoder units, or rpm of the motor.
        dead: Stations that do nothing any more.
    """

    def __init__(
        self,
        motors: Mapping[int, Motor],
        settings: Mapping[int, tuple[Setting, ...]] = NO_SETTINGS,
        drive_period_ns: int = DRIVE_PERIOD_NS,
    ) -> None:
        self.kernel = Kernel()
        self.wire = Wire(self.kernel, round(BAJA.bus.bitrate_bps))
        self.drives = {node_id: EposDrive(node_id, motor) for node_id, motor in motors.items()}
        steering, throttle = NODE_IDS["Steering"], NODE_IDS["Throttle"]
        position, velocity = OperationMode.PROFILE_POSITION, OperationMode.PROFILE_VELOCITY
        self.clients = {
            node_id: DriveClient(node_id, master, mode, settings.get(node_id, ()))
            for node_id, master, mode in (
                (STEER, steering, position),
                (LEFT, throttle, velocity),
                (RIGHT, throttle, velocity),
            )
        }
        self.values = dict.fromkeys(self.clients, 0)
        self.dead: set[str] = set()
        for node_id, drive in self.drives.items():
            name = drive_name(node_id)
            self._attach(name, drive_period_ns, DRIVE_PRIORITY, _drive_step(drive))
        self._attach("Steering", PERIOD_NS, NODE_PRIORITY, self._node_step(steering, (STEER,)))
        self._attach("Throttle", PERIOD_NS, NODE_PRIORITY, self._node_step(throttle, (LEFT, RIGHT)))

    def start(self) -> None:
        """The supervisor starts them, and the nodes enable their drives."""
        self.run_for(BOOT_S)
        self.wire.send(self.kernel.now_ns, "Supervisor", [nmt_frame(NmtCommand.START, 0)])
        self.run_for(ENABLE_S)
        assert all(client.is_following for client in self.clients.values())

    def run_for(self, span_s: float) -> None:
        """Goes on."""
        self.kernel.run_until(self.kernel.now_ns + round(span_s * 1e9))

    def every(self, period_ns: int, priority: int, action: Action) -> None:
        """From now on, first after one period."""

        def cycle(now_ns: int) -> None:
            self.kernel.at(now_ns + period_ns, priority, cycle)
            action(now_ns)

        self.kernel.at(self.kernel.now_ns + period_ns, priority, cycle)

    def _attach(self, name: str, period_ns: int, priority: int, step: Step) -> None:
        station = Receiver(name)
        self.wire.attach(station)

        def cycle(now_ns: int) -> None:
            heard, station.inbox = station.inbox, []
            if name not in self.dead:
                received = [ReceivedFrame(time_ns, frame) for time_ns, frame in heard]
                self.wire.send(now_ns, name, step(now_ns, received))

        self.every(period_ns, priority, cycle)

    def _node_step(self, own_id: int, node_ids: tuple[int, ...]) -> Step:
        def step(now_ns: int, received: list[ReceivedFrame]) -> list[Frame]:
            frames: list[Frame] = []
            for node_id in node_ids:
                client = self.clients[node_id]
                frames += client.step(now_ns, received, DriveWish.FOLLOW, self.values[node_id])
            if now_ns % HEARTBEAT_NS == 0:
                frames.append(Frame(HEARTBEAT_ID + own_id, bytes((NmtState.OPERATIONAL,))))
            return frames

        return step


def drive_name(node_id: int) -> str:
    """Of a drive's station."""
    return f"drive {node_id:#x}"


def _drive_step(drive: EposDrive) -> Step:
    return lambda now_ns, received: drive.step(now_ns, [item.frame for item in received])
