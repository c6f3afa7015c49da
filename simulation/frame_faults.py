"""Faults of single messages: lost, late, twice, corrupt, cut short, recorded, forged."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from numpy.random import Generator

from canbus.frame import Frame
from dbc.endpoint import SPEC_OF_NAME
from dbc.protection import COUNTER_BYTE, COUNTER_MODULO, PROTECTED_LENGTH, protect
from simulation.disturbance import Disturbance
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from simulation.overlay import Undo
from simulation.world import World

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
LATER_PRIORITY = -1
REPLAYER, FORGER = "replayer", "forger"


class FrameFaults:
    """Strikes frames between a node and its controller, or on the wire.

    Args:
        world: where.
        rng: which frames, which bits.
    """

    def __init__(self, world: World, rng: Generator) -> None:
        self._world = world
        self._rng = rng
        self._on_wire: list[Fault] = []
        self.corruption_listeners: list[Callable[[str, Frame, Frame], None]] = []

    def begin(self, fault: Fault) -> Undo:
        """A fault of one message begins."""
        match fault.kind:
            case FaultKind.CORRUPT_ON_WIRE:
                self._on_wire.append(fault)
                return lambda _: self._on_wire.remove(fault)
            case FaultKind.REPLAY | FaultKind.SPOOF:
                return self._follow(fault)
        return self._tamper(fault)

    @property
    def is_on_wire(self) -> bool:
        """Whether frames are to be disturbed on the wire."""
        return bool(self._on_wire)

    def disturb(self, frame: Frame) -> Disturbance | None:
        """What happens on the wire to a frame that begins now."""
        for fault in self._on_wire:
            if frame.can_id == SPEC_OF_NAME[fault.target].can_id and self._strikes(fault):
                return Disturbance(bit=int(fault.value))
        return None

    def _strikes(self, fault: Fault) -> bool:
        return fault.share == 1.0 or self._rng.random() < fault.share

    # Between node and controller -------------------------------------------------------------

    def _tamper(self, fault: Fault) -> Undo:
        spec = SPEC_OF_NAME[fault.target]
        assert spec.sender is not None  # nobody's messages are unprotected
        station = self._world.stations[spec.sender]

        def tamper(true_ns: int, frames: Sequence[Frame]) -> Sequence[Frame]:
            out: list[Frame] = []
            for frame in frames:
                if frame.can_id == spec.can_id and self._strikes(fault):
                    out += self._changed(true_ns, fault, frame, station.name)
                else:
                    out.append(frame)
            return out

        station.tampers.append(tamper)
        return lambda _: station.tampers.remove(tamper)

    def _changed(self, true_ns: int, fault: Fault, frame: Frame, sender: str) -> list[Frame]:
        """What becomes of one frame."""
        match fault.kind:
            case FaultKind.DROP:
                return []
            case FaultKind.DELAY:
                self._send_later(true_ns + round(fault.value * NS_PER_MS), sender, frame)
                return []
            case FaultKind.DUPLICATE:
                return [frame] * (1 + int(fault.value))
            case FaultKind.TRUNCATE:
                return [Frame(frame.can_id, frame.data[: int(fault.value)])]
        assert fault.kind is FaultKind.CORRUPT_BEFORE_CRC
        data = bytearray(frame.data)
        for bit in self._rng.choice(8 * len(data), size=int(fault.value), replace=False):
            data[int(bit) // 8] ^= 1 << int(bit) % 8
        heard = Frame(frame.can_id, bytes(data))
        for listener in self.corruption_listeners:
            listener(sender, frame, heard)
        return [heard]

    def _send_later(self, at_ns: int, sender: str, frame: Frame) -> None:
        wire = self._world.wire
        self._world.kernel.at(
            at_ns, LATER_PRIORITY, lambda now_ns: wire.send(now_ns, sender, [frame])
        )

    # By a stranger ---------------------------------------------------------------------------

    def _follow(self, fault: Fault) -> Undo:
        """A stranger hears the message and sends one of his own."""
        spec = SPEC_OF_NAME[fault.target]

        def witness(true_ns: int, sender: str, frame: Frame) -> None:
            if sender != spec.sender or frame.can_id != spec.can_id or not self._strikes(fault):
                return
            if fault.kind is FaultKind.REPLAY:
                delay_ns = round(fault.value * NS_PER_S)
                self._send_later(true_ns + delay_ns, REPLAYER, frame)
            elif len(frame.data) == PROTECTED_LENGTH:
                assert spec.data_id is not None
                self._send_later(true_ns, FORGER, self._forged(frame, spec.data_id))

        self._world.wire.witnesses.append(witness)
        return lambda _: self._world.wire.witnesses.remove(witness)

    def _forged(self, frame: Frame, data_id: int) -> Frame:
        """The next in sequence, with other content and all that protects it right."""
        counter = (frame.data[COUNTER_BYTE] + 1) % COUNTER_MODULO
        payload = bytearray(frame.data)
        payload[COUNTER_BYTE] &= 0xF0
        payload[4 + int(self._rng.integers(4))] ^= 1 << int(self._rng.integers(8))
        return Frame(frame.can_id, protect(payload, data_id, counter))
