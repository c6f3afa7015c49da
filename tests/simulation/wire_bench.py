"""A wire with bare stations: what is sent, heard and when, without any node."""

from __future__ import annotations

from canbus.frame import Frame
from canbus.timing import bits_time_ns, frame_time_ns
from simulation.controller import DEFAULT_SETTINGS, ControllerSettings, ErrorState
from simulation.disturbance import Disturbance
from simulation.kernel import Kernel
from simulation.wire import Receiver, Wire

BITRATE_BPS = 500_000
BIT_NS = 2_000
SPACE_NS = 3 * BIT_NS


class Ear(Receiver):
    """A station that hears everything, unless it is told otherwise."""

    wanted: frozenset[int] | None = None

    @property
    def acceptance(self) -> frozenset[int] | None:
        return self.wanted


class Bench:
    """Stations A, B and C on one wire; `said` is what went through, `(time, sender, frame)`."""

    def __init__(self, names: str = "ABC", **settings: ControllerSettings) -> None:
        self.kernel = Kernel()
        self.wire = Wire(self.kernel, BITRATE_BPS)
        self.ears = {name: Ear(name) for name in names}
        for name, ear in self.ears.items():
            self.wire.attach(ear, settings.get(name, DEFAULT_SETTINGS))
        self.said: list[tuple[int, str, Frame]] = []
        self.wire.witnesses.append(lambda ns, sender, frame: self.said.append((ns, sender, frame)))
        self.noise: list[Disturbance | None] = []
        """What happens to the next frames, one after the other."""

    def disturb(self, *noise: Disturbance | None) -> None:
        """The next frames that begin are disturbed so."""
        if not self.wire.disturbers:
            self.wire.disturbers.append(
                lambda ns, sender, frame: self.noise.pop(0) if self.noise else None
            )
        self.noise += noise

    def send(self, sender: str, *frames: Frame) -> None:
        """Now."""
        self.wire.send(self.kernel.now_ns, sender, frames)

    def run(self, span_ns: int = 10_000_000) -> None:
        """Lets time pass."""
        self.kernel.run_until(self.kernel.now_ns + span_ns)

    def order(self) -> list[tuple[str, int]]:
        """Who said which identifier, in order."""
        return [(sender, frame.can_id) for _, sender, frame in self.said]

    def heard(self, name: str) -> list[Frame]:
        """What a station has heard."""
        return [frame for _, frame in self.ears[name].inbox]

    def state(self, name: str) -> ErrorState:
        """What a station's controller may do."""
        return self.wire.controllers[name].state

    def counters(self, name: str) -> tuple[int, int]:
        """Transmit and receive error counter."""
        controller = self.wire.controllers[name]
        return controller.transmit_errors, controller.receive_errors


def end_ns(begin_ns: int, frame: Frame) -> int:
    """When a frame that begins then is heard."""
    return begin_ns + frame_time_ns(frame, BITRATE_BPS) - SPACE_NS


def bits_ns(bits: int) -> int:
    """Duration of so many bits."""
    return bits_time_ns(bits, BITRATE_BPS)
