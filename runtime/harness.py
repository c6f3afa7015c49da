"""The wires between an ECU and its hardware, carried as frames of `harness.dbc`.

On a desk the plant is another thread or process, and a second bus stands for the wires. On a car
hardware drivers take this place: they implement `ActuatorPort`, and nothing else changes.

A wire that is cut reads as broken, not as its last value: after `STALE_NS` without a frame every
analogue reading is NaN, the encoders stand still and the emergency-stop line, closed-circuit by
nature, reads as pressed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

from canbus.bus import Bus
from canbus.frame import Frame, FrameKind, ReceivedFrame
from dbc.codec import encode
from dbc.harness import SPECS, DriverHandsWire
from dbc.spec import MessageSpec, SignalRangeError
from runtime.clock import NS_PER_S

STALE_NS = 50_000_000
"""As the actuators' hardware watchdogs: four frames in a row may be lost, not five."""

EDGE_AGE_S_MAX = 1.0
"""An encoder's edge timer saturates here (`ecus/*/ports.py`)."""

SPEC_OF_NAME: dict[str, MessageSpec] = {spec.name: spec for spec in SPECS.values()}
"""Harness messages by their DBC name."""

HANDS_OFF = DriverHandsWire(
    steering_torque_nm=0.0,
    throttle_pedal_ratio=0.0,
    brake_pedal_ratio=0.0,
    button_pressed=False,
    emergency_stop_pressed=False,
)
"""A driver who does nothing."""

SensorsT = TypeVar("SensorsT", covariant=True)
ActuatorT = TypeVar("ActuatorT", contravariant=True)


class ActuatorPort(Protocol[SensorsT, ActuatorT]):
    """A node's hardware: readings in, commands out. None of its methods waits.

    The hardware has its own watchdog (50 ms): when `actuate` is not called in time, it goes to
    its safe state without software. An exception from any method ends the node.
    """

    def poll(self) -> None:
        """Takes in what has arrived; called whenever the node wakes up."""
        ...

    def sensors(self, now_ns: int) -> SensorsT:
        """The newest readings; NaN, or the safe side, for what cannot be read."""
        ...

    def actuate(self, now_ns: int, actuator: ActuatorT) -> None:
        """Puts a command into force and feeds the hardware's watchdog."""
        ...


class Wires(Protocol[SensorsT, ActuatorT]):
    """One node's share of the harness; no input or output of its own."""

    @property
    def acceptance(self) -> frozenset[int]:
        """Identifiers of the harness bus that this node reads."""
        ...

    def take(self, received: Sequence[ReceivedFrame]) -> None:
        """Takes in frames of the harness bus."""
        ...

    def sensors(self, now_ns: int) -> SensorsT:
        """Readings as they are to be believed now."""
        ...

    def frames(self, actuator: ActuatorT) -> list[Frame]:
        """The frames that carry a command to the plant."""
        ...


def harness_frame(name: str, message: object) -> Frame:
    """The frame that carries one harness message.

    Raises:
        SignalRangeError: A value outside its signal's range, or NaN where that has no code.
    """
    return encode(SPEC_OF_NAME[name], message)


class Reading(NamedTuple):
    """A harness message with its arrival time."""

    arrival_ns: int
    content: Any


def decode_harness(item: ReceivedFrame) -> Reading | None:
    """Content of a harness frame; None for one that cannot be used."""
    frame = item.frame
    spec = SPECS.get(frame.can_id)
    if spec is None or frame.kind is not FrameKind.DATA or len(frame.data) != spec.length:
        return None
    try:
        return Reading(item.arrival_ns, spec.unpack(int.from_bytes(frame.data, "little")))
    except (SignalRangeError, KeyError):
        return None


class Inbox:
    """The newest harness message per name.

    Attributes:
        acceptance: identifiers of the messages wanted.
        bad_frames: frames with a wanted identifier that could not be used.
    """

    def __init__(self, *names: str) -> None:
        self.acceptance = frozenset(SPEC_OF_NAME[name].can_id for name in names)
        self.bad_frames = 0
        self._newest: dict[int, Reading] = {}

    def take(self, received: Sequence[ReceivedFrame]) -> None:
        """Keeps the newest of each."""
        for item in received:
            if item.frame.can_id not in self.acceptance:
                continue
            reading = decode_harness(item)
            if reading is None:
                self.bad_frames += 1
            else:
                self._newest[item.frame.can_id] = reading

    def newest(self, name: str) -> Reading | None:
        """The newest message, however old; None before the first."""
        return self._newest.get(SPEC_OF_NAME[name].can_id)


def is_stale(reading: Reading | None, now_ns: int) -> bool:
    """Whether a wire is silent: never heard, or not for `STALE_NS`."""
    return reading is None or now_ns - reading.arrival_ns > STALE_NS


def edge_age_s(age_s: float, reading: Reading, now_ns: int) -> float:
    """Age of an encoder's latest edge now, from its age when the frame arrived.

    The sum keeps count and edge time a true pair however late the node reads the frame.
    """
    return min(EDGE_AGE_S_MAX, age_s + (now_ns - reading.arrival_ns) / NS_PER_S)


class HarnessPort:
    """An `ActuatorPort` over the harness bus.

    Args:
        wires: the node's share of the harness.
        bus: the harness bus, open, with the wires' acceptance.

    Attributes:
        tx_failures: actuator frames the driver refused; the hardware watchdog is then not fed.
    """

    def __init__(self, wires: Wires[Any, Any], bus: Bus) -> None:
        self._wires = wires
        self._bus = bus
        self.tx_failures = 0

    def poll(self) -> None:
        """Takes in what waits on the harness bus."""
        self._wires.take(self._bus.receive(0))

    def sensors(self, now_ns: int) -> Any:
        """The newest readings; NaN, or the safe side, for what cannot be read."""
        return self._wires.sensors(now_ns)

    def actuate(self, now_ns: int, actuator: Any) -> None:
        """Sends a command to the plant.

        Raises:
            SignalRangeError: the command is no possible one (NaN, out of range).
        """
        for frame in self._wires.frames(actuator):
            self.tx_failures += not self._bus.send(frame)
