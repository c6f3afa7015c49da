"""A drive in virtual time with an oracle that watches it."""

from __future__ import annotations

from typing import Any

from canbus.frame import Frame
from dbc.messages import Mode, Request
from oracle.judge import Oracle
from oracle.report import OracleReport
from simulation.observer import Observer
from tests.scenarios.driving import TABBY, Drive
from vehicles import Vehicle


class Watched(Drive):
    """The scenarios' drive; what a test breaks or touches is told to the oracle."""

    def __init__(self, seed: int = 1, vehicle: Vehicle = TABBY) -> None:
        super().__init__(seed, vehicle)
        self.oracle = Oracle(vehicle)
        self.observer = Observer(self.world, self.oracle, self._path_error_m)
        self.is_on_path = False

    def _path_error_m(self) -> float:
        """From the x axis, for a car that is to drive along it."""
        return self.car.pose.y_m if self.is_on_path else float("nan")

    def touch(self, **controls: float | bool) -> None:
        """The driver does something from now on."""
        for name, value in controls.items():
            setattr(self.car.driver, name, value)
        self.observer.look()

    def tell(self, kind: str, is_begin: bool = True, **how: Any) -> None:
        """A fault that the test itself makes."""
        self.oracle.on_fault(self.world.now_ns, kind, "part", is_begin, **how)

    def break_part(self, fault: str, value: object = True, **how: Any) -> None:
        """A part of the car breaks."""
        self.tell(fault, **how)
        setattr(self.car.faults, fault, value)

    def push(self) -> Watched:
        """A push of the button."""
        self.touch(button_pressed=True)
        self.run(0.1)
        self.touch(button_pressed=False)
        self.run(0.06)
        return self

    def to_ready(self) -> Watched:
        """From power-on to READY."""
        self.start()
        return self.push()

    def away(self, speed_mps: float = 5.0, curvature_per_m: float = 0.0) -> Watched:
        """From power-on to a drive."""
        self.to_ready()
        self.engage(0.1)
        self.speed_mps = speed_mps
        self.run(speed_mps / 1.4 + 0.5)
        self.curvature_per_m = curvature_per_m
        self.run(1.0)
        return self

    def stop(self) -> Watched:
        """The planner asks for the emergency brake."""
        self.request(Request.EMERGENCY_STOP, 0.1)
        return self

    def from_gateway(self, frame: Frame) -> None:
        """A frame that the gateway seems to send, and does."""
        self.world.inject(frame, "Gateway")

    def report(self) -> OracleReport:
        """What the oracle found."""
        return self.oracle.finish(self.world.now_ns)


def is_reset(drive: Watched) -> bool:
    """Asks for a reset; whether it was granted."""
    drive.request(Request.RESET, 0.3)
    return drive.mode is Mode.MANUAL
