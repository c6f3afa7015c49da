"""The CANopen side of a drive: the object dictionary's values, PDO, and the master's heartbeat."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from importlib.resources import files
from typing import Final

from canbus import canopen_protocol as cia301
from canbus import cia402
from canbus.canopen_device import ALL_INDICES, CanopenDevice
from canbus.canopen_protocol import NmtState
from canbus.frame import Frame, FrameKind
from simulation.drives import pdo

EDS: Final = str(files("dbc").joinpath("eds", "drive.eds"))

_SIGNED: Final = frozenset({0x02, 0x03, 0x04})
_VALUES_MIN: Final = pdo.RPDO_SETTINGS.start
"""Objects from here on are numbers, and kept as such."""
_CONSUMER: Final = 0x1016
_CONSUMER_NODE_SHIFT: Final = 16

PDO_TOO_SHORT: Final = 0x8210
"""Emergency code of CiA 301, table 26."""

_CHOICES: Final[Mapping[int, Collection[int]]] = {
    cia402.MODE: frozenset(cia402.OperationMode),
    cia402.HOMING_METHOD: frozenset(cia402.HomingMethod),
    cia402.QUICK_STOP_OPTION: frozenset(cia402.StopOption),
    cia402.HALT_OPTION: (cia402.StopOption.SLOW_DOWN, cia402.StopOption.QUICK_STOP),
    cia402.ABORT_CONNECTION_OPTION: frozenset(cia402.AbortOption),
}
"""Objects that take certain numbers alone, which limits cannot say."""


class DriveDevice(CanopenDevice):
    """A drive's end of the bus.

    Args:
        node_id: 1 to 127.
        start_values: values by object that replace the EDS's defaults.
        changed: called when the master has written objects of the profile: once after an SDO
            write, once after all values of a PDO.

    Attributes:
        values: the numbers of all objects from 1400 on, by index and sub-index in one. The drive
            writes what it measures into it; a reset fills it anew.
        bad_pdos: PDO that were too short, or values in one that SDO would refuse.
    """

    def __init__(
        self, node_id: int, start_values: Mapping[int, int], changed: Callable[[], None]
    ) -> None:
        super().__init__(node_id, EDS)
        self.values: dict[int, int] = {}
        self.bad_pdos = 0
        self._changed = changed
        self._start_values = [(key >> 8, key & 0xFF, raw) for key, raw in start_values.items()]
        self._own_acceptance = self.acceptance
        self._received: dict[int, pdo.Received] = {}
        self._sent: list[pdo.Sent] = []
        self._master_id = 0
        self._master_silence_ns = 0
        self._heard_ns: int | None = None
        self._reset_objects(ALL_INDICES)

    def receive(self, now_ns: int, received: Iterable[Frame]) -> list[Frame]:
        """Takes frames in, in their order; returns answers, the boot-up and the heartbeat."""
        frames = self.step(now_ns)
        for frame in received:
            arriving = self._received.get(frame.can_id)
            if arriving is not None:
                self._take_pdo(now_ns, arriving, frame)
            elif self._master_id and frame.can_id == cia301.HEARTBEAT_ID + self._master_id:
                if cia301.heartbeat_state(frame) is not None:
                    self._heard_ns = now_ns
            elif frame.can_id in self._own_acceptance:
                before = self.state
                frames += self.step(now_ns, (frame,))
                if before is not self.state:
                    self._arrange()
        return frames

    def is_master_lost(self, now_ns: int) -> bool:
        """Whether the master has just been silent for too long; true once for each silence.

        Watched from its first heartbeat on (CiA 301, 7.2.8.2.2).
        """
        if self._heard_ns is None or now_ns - self._heard_ns <= self._master_silence_ns:
            return False
        self._heard_ns = None
        return True

    def send(self, now_ns: int) -> list[Frame]:
        """What is due: emergencies, and TPDO while OPERATIONAL."""
        frames = self.step(now_ns)
        if self.state is NmtState.OPERATIONAL:
            for leaving in self._sent:
                frames += leaving.due(now_ns, self.values)
        return frames

    def _take_pdo(self, now_ns: int, arriving: pdo.Received, frame: Frame) -> None:
        if self.state is not NmtState.OPERATIONAL:
            return
        if frame.kind is not FrameKind.DATA or len(frame.data) < arriving.byte_count:
            self.bad_pdos += 1
            self.emergency(now_ns, PDO_TOO_SHORT, self.number(cia301.ERROR_REGISTER) | 0x11)
            return
        for key, raw in arriving.values(frame.data).items():
            if self._refusal(key >> 8, key & 0xFF, raw):
                self.bad_pdos += 1
            else:
                self.values[key] = raw
        self._changed()

    def _refusal(self, index: int, subindex: int, raw: int) -> int:
        key = index << 8 | subindex
        if raw not in _CHOICES.get(key, (raw,)):
            return cia301.ABORT_VALUE
        if index in pdo.SETTINGS or index in pdo.MAPPINGS:
            return pdo.refusal(self.number, self._bits_of_mappable, index, subindex, raw)
        return 0

    def _written(self, index: int, subindex: int, raw: int) -> None:
        if index == _CONSUMER:
            self._watch_master(raw)
        if index < _VALUES_MIN:
            return
        self.values[index << 8 | subindex] = raw
        if index in pdo.SETTINGS or index in pdo.MAPPINGS:
            self._arrange()
        else:
            self._changed()

    def _live(self, index: int, subindex: int) -> int | None:
        return self.values.get(index << 8 | subindex)

    def _objects_reset(self, indices: Collection[int]) -> None:
        again = {index for index in self._dictionary if index in indices and index >= _VALUES_MIN}
        for key in [key for key in self.values if key >> 8 in again]:
            del self.values[key]
        for index in again:
            for subindex in self.members(index):
                self.values[index << 8 | subindex] = self.number(index, subindex)
        if _CONSUMER in indices:
            self._watch_master(self.number(_CONSUMER, 1))
        self._arrange()

    def _watch_master(self, raw: int) -> None:
        """Object 1016: whose heartbeat is waited for, and how long; 0: nobody's."""
        silence_ms = raw & 0xFFFF
        self._master_id = raw >> _CONSUMER_NODE_SHIFT & 0x7F if silence_ms else 0
        self._master_silence_ns = silence_ms * cia301.HEARTBEAT_UNIT_NS
        self._heard_ns = None
        self._accept()

    def _bits_of_mappable(self, key: int, is_received: bool) -> int:
        index, subindex = key >> 8, key & 0xFF
        if index not in self._dictionary or subindex not in self.members(index):
            return 0
        variable = self._device.variable(index, subindex)
        is_open = variable.writable if is_received else variable.readable
        return len(variable) if variable.pdo_mappable and is_open else 0

    def _is_signed(self, key: int) -> bool:
        return self._device.variable(key >> 8, key & 0xFF).data_type in _SIGNED

    def _mapping(self, index: int) -> list[pdo.Entry]:
        number = self.values
        return [
            pdo.entry_of(number[index << 8 | member], self._is_signed)
            for member in range(1, number[index << 8] + 1)
        ]

    def _arrange(self) -> None:
        """Makes the PDO after the objects; each TPDO leaves anew at once."""
        number, self._received, self._sent = self.values, {}, []
        for settings, mapping in zip(pdo.RPDO_SETTINGS, pdo.RPDO_MAPPINGS, strict=True):
            cob_id = number[settings << 8 | 1]
            if not cob_id & pdo.INVALID:
                self._received[cob_id & 0x7FF] = pdo.Received(cob_id, self._mapping(mapping))
        for settings, mapping in zip(pdo.TPDO_SETTINGS, pdo.TPDO_MAPPINGS, strict=True):
            cob_id = number[settings << 8 | 1]
            if not cob_id & pdo.INVALID:
                inhibit, event = number[settings << 8 | 3], number[settings << 8 | 5]
                self._sent.append(
                    pdo.Sent(cob_id & 0x7FF, self._mapping(mapping), inhibit, event)
                )
        self._accept()

    def _accept(self) -> None:
        """The identifiers that are wanted now."""
        heartbeats = {cia301.HEARTBEAT_ID + self._master_id} if self._master_id else set()
        self.acceptance = frozenset({*self._own_acceptance, *self._received, *heartbeats})
