"""The stock CiA 402 master of the canopen package drives the simulated drive, in virtual time.

Its clock and its waiting are replaced, nothing else: the master's own transitions, mode changes and
homing run against the drive's EDS and mappings.
"""

from __future__ import annotations

import queue
from collections.abc import Iterator
from typing import Any

import canopen
import pytest
from canopen import emcy, nmt
from canopen.profiles import p402
from canopen.profiles.p402 import BaseNode402

from canbus import cia402
from canbus.cia402 import RPM_PER_RADPS, HomingMethod
from canbus.frame import Frame
from simulation.drives.device import EDS
from simulation.drives.faults import DriveFault
from tests.simulation.drive_rig import NODE_ID, Rig


class Waiting:
    """A condition whose waiting passes virtual time until it is notified."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._is_notified = False

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...

    def notify_all(self) -> None:
        self._is_notified = True

    def wait(self, timeout: float) -> bool:
        self._is_notified = False
        for _ in range(round(timeout * 1000)):
            self._bench.run(1)
            if self._is_notified:
                break
        return self._is_notified


class Responses:
    """SDO answers; waiting for one passes virtual time."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._items: list[bytes] = []

    def put(self, item: bytes) -> None:
        self._items.append(item)

    def empty(self) -> bool:
        self._items.clear()
        return True

    def get(self, block: bool, timeout: float) -> bytes:
        for _ in range(round(timeout * 1000)):
            if self._items:
                return self._items.pop(0)
            self._bench.run(1)
        raise queue.Empty


class Bench(Rig):
    """A drive, and the stock master on the same virtual bus."""

    def __init__(self) -> None:
        super().__init__()
        bench = self

        class Network(canopen.Network):
            def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
                bench.send(Frame(can_id, bytes(data)))

        self.network = Network()
        self.node = BaseNode402(NODE_ID, EDS)
        self.network.add_node(self.node)
        self.node.sdo.responses = Responses(self)
        pdos = (*self.node.tpdo.values(), *self.node.rpdo.values())
        for owner, name in (
            (self.node.nmt, "state_update"),
            (self.node.emcy, "emcy_received"),
            *((pdo, "receive_condition") for pdo in pdos),
        ):
            assert hasattr(owner, name)
            setattr(owner, name, Waiting(self))

    def run(self, duration_ms: int, each_step: Any = lambda: None) -> list[Frame]:
        sent = []
        for _ in range(duration_ms):
            frames = super().run(1)
            sent += frames
            for frame in frames:
                if hasattr(self, "network"):
                    data = bytearray(frame.data)
                    self.network.notify(frame.can_id, data, self.now_ns / 1e9)
        return sent

    def monotonic(self) -> float:
        """The clock that canopen reads in place of the machine's."""
        return self.now_ns / 1e9

    time = monotonic


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    bench = Bench()
    for module in (p402, nmt, emcy):
        monkeypatch.setattr(module, "time", bench)
    bench.node.nmt.state = "PRE-OPERATIONAL"
    bench.run(2)
    bench.node.setup_402_state_machine()
    bench.node.nmt.state = "OPERATIONAL"
    bench.run(60)
    yield bench


def test_the_master_reads_the_mappings_and_finds_its_words(bench: Bench) -> None:
    assert set(bench.node.rpdo_pointers) == {0x6040, 0x607A, 0x60FF}
    assert set(bench.node.tpdo_values) == {0x6041, 0x6064, 0x6061, 0x606C, 0x6078}
    assert bench.node.state == "SWITCH ON DISABLED"


def test_the_master_enables_the_drive_step_by_step_and_takes_it_back(bench: Bench) -> None:
    start_ns = bench.now_ns
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "SWITCHED ON",
                  "READY TO SWITCH ON", "SWITCH ON DISABLED"):  # fmt: skip
        bench.node.state = state
        assert bench.node.state == state
    bench.node.state = "OPERATION ENABLED"  # three transitions in one assignment
    assert bench.node.state == "OPERATION ENABLED"
    assert bench.now_ns - start_ns < 400e6


def test_the_master_drives_a_profile_velocity(bench: Bench) -> None:
    node = bench.node
    node.op_mode = "PROFILED VELOCITY"
    assert node.op_mode == "PROFILED VELOCITY"
    node.state = "OPERATION ENABLED"
    node.rpdo[2]["Target velocity"].raw = 1500
    node.rpdo[2]["Controlword"].raw = 0x0F
    node.rpdo[2].transmit()
    bench.run(1000)
    assert node.statusword & cia402.TARGET_REACHED
    assert node.tpdo_values[0x606C] == pytest.approx(1500, abs=10)
    assert bench.motor.speed_radps * RPM_PER_RADPS == pytest.approx(1500, abs=10)
    node.state = "QUICK STOP ACTIVE"
    bench.run(300)
    assert node.tpdo_values[0x606C] == 0


def test_the_master_drives_a_profile_position(bench: Bench) -> None:
    node = bench.node
    node.op_mode = "PROFILED POSITION"
    node.sdo[0x6081].raw = 2000
    node.state = "OPERATION ENABLED"
    node.rpdo[1]["Target position"].raw = -12_345
    for controlword in (0x3F, 0x0F):
        node.rpdo[1]["Controlword"].raw = controlword
        node.rpdo[1].transmit()
        bench.run(20)
    bench.run(1000)
    assert node.statusword & cia402.TARGET_REACHED
    assert node.tpdo_values[0x6064] == -12_345
    assert node.sdo[0x6064].raw == -12_345


def test_the_master_homes_the_drive(bench: Bench) -> None:
    node = bench.node
    node.sdo[0x6098].raw = int(HomingMethod.INDEX_POSITIVE)
    node.sdo[0x607C].raw = 77
    bench.motor.angle_rad = 2.0
    assert node.homing(timeout=5)
    assert node.is_homed()
    bench.run(50)
    assert node.tpdo_values[0x6064] == pytest.approx(77, abs=200)


def test_the_master_sees_a_fault_and_resets_it(bench: Bench) -> None:
    node = bench.node
    node.state = "OPERATION ENABLED"
    bench.drive.fail(DriveFault.OVERTEMPERATURE)
    bench.run(300)
    assert node.is_faulted()
    assert node.state == "FAULT"
    (entry,) = node.emcy.active
    assert (entry.code, entry.register) == (0x4210, 0x09)
    bench.drive.mend(DriveFault.OVERTEMPERATURE)
    start_ns = bench.now_ns
    node.reset_from_fault()
    assert node.state == "OPERATION ENABLED"
    assert bench.now_ns - start_ns >= 400e6, "the stock master always waits for its time-out"
    assert node.emcy.active == []


def test_the_master_maps_and_saves_another_pdo(bench: Bench) -> None:
    node = bench.node
    node.nmt.state = "PRE-OPERATIONAL"
    bench.run(5)
    tpdo = node.tpdo[2]
    tpdo.clear()
    tpdo.add_variable("Statusword")
    tpdo.add_variable("Velocity demand value")
    tpdo.event_timer, tpdo.enabled = 50, True
    tpdo.save()
    node.nmt.state = "OPERATIONAL"
    bench.run(200)
    assert tpdo["Velocity demand value"].raw == 0
    assert tpdo["Statusword"].raw == bench.drive.values[cia402.STATUSWORD]


def test_what_the_drive_does_not_support_the_master_is_told(bench: Bench) -> None:
    assert bench.node.is_op_mode_supported("HOMING")
    for mode in ("VELOCITY", "PROFILED TORQUE", "CYCLIC SYNCHRONOUS POSITION"):
        with pytest.raises(TypeError, match="not suppported"):
            bench.node.op_mode = mode
    with pytest.raises(canopen.SdoAbortedError, match="0x06090030"):
        bench.node.sdo[0x6060].raw = 2
