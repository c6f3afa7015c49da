"""Why a drive ended, in a car whose motors hang on drives: the drive is named, not its ECU."""

from __future__ import annotations

import numpy as np
import pytest

from canbus import cia402
from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from simulation.injector import Injector
from telemetry.why.incident import Cause, CauseKind, Incident, Kind
from telemetry.why.watch import Watch
from telemetry.why.words import summary
from tests.scenarios.driving import Drive
from vehicles import load_vehicle

pytestmark = pytest.mark.whole_car

BAJA = load_vehicle("baja_5b")
K, C = FaultKind, CauseKind
STEERING, LEFT, RIGHT = "SteeringDrive", "LeftWheelDrive", "RightWheelDrive"


class Recorded:
    """A car that drives itself, every frame of it, and what is said of its end."""

    def __init__(self, *, is_driving: bool = True) -> None:
        self.frames: list[tuple[int, Frame]] = []
        self.drive = Drive(vehicle=BAJA)
        self.drive.world.wire.witnesses.append(
            lambda true_ns, sender, frame: self.frames.append((true_ns, frame))
        )
        if is_driving:
            self.drive.go(1.5, 0.2)
        self.injector = Injector(self.drive.world, np.random.default_rng(1))

    def inject(self, *faults: Fault) -> Recorded:
        for fault in faults:
            self.injector.begin(fault)
        return self

    @property
    def end(self) -> Incident:
        self.drive.run(1.3)
        return next(
            item for item in Watch(BAJA).follow(self.frames)
            if isinstance(item, Incident) and item.kind is Kind.EMERGENCY_BRAKE
        )

    @property
    def cause(self) -> Cause:
        return self.end.cause


@pytest.mark.parametrize(
    ("kind", "target", "named", "text"),
    [
        (K.DRIVE_FAULT, STEERING, C.MOTOR_FAULT,
         "the steering drive reported a fault: 0x2310 current, output side"),
        (K.DRIVE_FAULT, RIGHT, C.MOTOR_FAULT,
         "the right wheel's drive reported a fault: 0x2310 current, output side"),
        (K.DRIVE_DEAF, LEFT, C.MOTOR_FAULT,
         "the left wheel's drive reported a fault: 0x8130 communication"),
        (K.DRIVE_DEAD, STEERING, C.NODE_SILENT, "the steering drive fell silent"),
        (K.DRIVE_DEAD, LEFT, C.NODE_SILENT, "the left wheel's drive fell silent"),
        (K.DRIVE_MUTE, RIGHT, C.NODE_SILENT, "the right wheel's drive fell silent"),
    ],
)
def test_the_drive_is_named(kind: FaultKind, target: str, named: CauseKind, text: str) -> None:
    recorded = Recorded()
    began_ns = recorded.drive.world.now_ns
    end = recorded.inject(Fault(kind=kind, target=target)).end
    cause = end.cause
    assert (cause.kind, cause.subject, cause.text) == (named, target, text)
    assert cause.since_ns is not None and abs(cause.since_ns - began_ns) < 200_000_000
    assert summary(end, lambda ns: "T").startswith(f"The car braked because {text}, from T on. ")


def test_a_drive_that_lost_its_power_for_a_moment_has_started_anew() -> None:
    recorded = Recorded().inject(Fault(kind=K.DRIVE_DEAD, target=LEFT, for_s=0.02))
    cause = recorded.cause
    assert (cause.kind, cause.subject) == (C.NODE_RESTARTED, LEFT)
    assert cause.text == "the left wheel's drive started anew"


def test_two_drives_at_once_are_both_told() -> None:
    faults = [Fault(kind=K.DRIVE_MUTE, target=name) for name in (LEFT, RIGHT)]
    causes = Recorded().inject(*faults).end.causes
    assert [(cause.kind, cause.subject) for cause in causes] == [
        (C.NODE_SILENT, LEFT), (C.NODE_SILENT, RIGHT)
    ]


def test_an_ecu_that_dies_is_still_the_one_that_is_named() -> None:
    cause = Recorded().inject(Fault(kind=K.CRASH, target="Throttle")).cause
    assert (cause.kind, cause.subject) == (C.NODE_SILENT, "Throttle")


def test_a_drive_that_is_not_switched_on_is_told_in_its_ecus_words(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recorded = Recorded(is_driving=False)
    drive = recorded.drive.start()
    drive.press_button()
    assert drive.car.train is not None
    monkeypatch.setattr(drive.car.train.steering.drive, "_change", lambda event: None)  # STO open
    drive.speed_mps = 1.0
    drive.engage(0.2)
    cause = recorded.cause
    assert (cause.kind, cause.subject) == (C.MOTOR_FAULT, "Steering")
    assert cause.text == (
        "the steering ECU found a motor drive in a fault, with a setting refused, or not switched "
        "on"
    )


def test_a_drive_in_another_mode_is_named() -> None:
    recorded = Recorded()
    assert recorded.drive.car.train is not None
    left = recorded.drive.car.train.left.drive
    left._device.values[cia402.MODE] = cia402.OperationMode.HOMING
    cause = recorded.cause
    assert (cause.kind, cause.subject) == (C.NOT_FOLLOWING, LEFT)
    assert cause.text == "the left wheel's drive was in another mode of operation"


@pytest.mark.parametrize("ecu", ["Steering", "Throttle"])
def test_an_ecu_that_no_longer_hears_is_told_from_a_silent_drive(ecu: str) -> None:
    cause = Recorded().inject(Fault(kind=K.DEAF, target=ecu)).cause
    assert (cause.kind, cause.subject) == (C.NODE_DEAF, ecu)


def test_a_drive_of_which_the_log_has_no_frame_was_not_heard_at_all() -> None:
    recorded = Recorded().inject(Fault(kind=K.DRIVE_MUTE, target=RIGHT))
    recorded.drive.run(1.3)
    right = {base + 0x13 for base in (0x080, 0x180, 0x280, 0x580, 0x700)}
    frames = [item for item in recorded.frames if item[1].can_id not in right]
    end = next(
        item for item in Watch(BAJA).follow(frames)
        if isinstance(item, Incident) and item.kind is Kind.EMERGENCY_BRAKE
    )
    assert (end.cause.kind, end.cause.subject) == (C.NODE_SILENT, RIGHT)
    assert end.cause.text == "the right wheel's drive was not heard at all"
    assert end.cause.since_ns is None


def test_a_drive_in_nmt_stop_is_silent_though_its_heart_beats() -> None:
    recorded = Recorded()
    assert BAJA.drives is not None
    recorded.drive.world.inject(nmt_frame(NmtCommand.STOP, BAJA.drives.left_wheel_node_id))
    cause = recorded.cause
    assert (cause.kind, cause.subject) in {(C.NODE_SILENT, LEFT), (C.MOTOR_FAULT, LEFT)}
