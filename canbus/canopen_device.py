"""A CANopen slave without threads and under any clock. The only module that imports canopen.

Built on the extension points the package documents: a `canopen.Network` whose `send_message` and
`send_periodic` are overridden and which is fed by `notify`. Where canopen 2.4 departs from
CiA 301, the subclasses here put it right: NMT reset (endless boot-ups), SDO while STOPPED and
after a malformed request, sub-indices of plain variables, and the limits of the EDS.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Callable, Collection, Iterable
from pathlib import Path

from canbus import canopen_protocol as cia301
from canbus import canopen_schedule as schedule
from canbus.canopen_parameters import EdsVariable
from canbus.canopen_protocol import (
    CanopenEvent,
    CanopenEventKind,
    NmtCommand,
    NmtState,
)
from canbus.frame import Frame, FrameKind
from canbus.hidden import ASAMMDF, hidden

with hidden(ASAMMDF):
    import canopen
    from canopen.network import PeriodicMessageTask
    from canopen.nmt import NmtSlave
    from canopen.objectdictionary import ObjectDictionary, ODVariable
    from canopen.objectdictionary.eds import import_eds
    from canopen.sdo import constants as sdo
    from canopen.sdo.exceptions import SdoAbortedError
    from canopen.sdo.server import SdoServer

DOWNLOAD_BYTES_MAX = 64
"""Longest segmented write taken in; nothing writable is longer than four bytes."""

ALL_INDICES = range(0x10000)
_RESETS = (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)
_NMT_COMMANDS = frozenset(NmtCommand)

# canopen logs what it also answers; without a handler Python prints warnings to stderr.
logging.getLogger("canopen").addHandler(logging.NullHandler())


class _CyclicTask(PeriodicMessageTask):
    """What canopen holds of a periodic frame; the base class would start a thread for it."""

    def __init__(self, frame: schedule.CyclicFrame) -> None:
        self._frame = frame

    def stop(self) -> None:
        self._frame.next_ns = schedule.NEVER_NS

    def update(self, data: bytes) -> None:
        self._frame.data = bytes(data)


class _Network(canopen.Network):
    """Collects what the node sends, and keeps its periodic frames, in the caller's time."""

    def __init__(self) -> None:
        super().__init__()
        self.now_ns = 0
        self.outbox: list[Frame] = []
        self.cyclic = schedule.CyclicSchedule()

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        assert not remote, "no node of ours sends remote frames"
        self.outbox.append(Frame(can_id, bytes(data)))

    def send_periodic(
        self, can_id: int, data: bytes, period: float, remote: bool = False
    ) -> _CyclicTask:
        assert not remote, "no node of ours sends remote frames"
        frame = schedule.CyclicFrame(can_id, bytes(data), round(period * 1e9))
        self.cyclic.add(frame, self.now_ns)
        return _CyclicTask(frame)


class _Slave(NmtSlave):
    """NMT slave that survives a reset: canopen's would announce itself for ever."""

    def __init__(self, node_id: int, device: _Device, owner: Callable[[NmtCommand], None]) -> None:
        super().__init__(node_id, device)
        self._owner = owner

    @property
    def number(self) -> NmtState:
        """The state as CiA 301 numbers it; the base class offers names."""
        return NmtState(self._state)

    def boot(self) -> None:
        """Announce the node once, go to PRE-OPERATIONAL, start the heartbeat anew."""
        self.network.send_message(cia301.HEARTBEAT_ID + self.id, bytes(1))
        self._state = NmtState.PRE_OPERATIONAL
        self.start_heartbeat(self._local_node.number(cia301.HEARTBEAT_TIME))

    def on_command(self, can_id: int, data: bytes, timestamp: float) -> None:
        command, node_id = NmtCommand(data[0]), data[1]
        if node_id not in (0, self.id):
            return
        if command not in _RESETS:
            super().on_command(can_id, data, timestamp)
        self._owner(command)
        if command in _RESETS:
            self.boot()


class _Server(SdoServer):
    """SDO server that answers every request with a response or an abort, and never raises."""

    def __init__(self, node_id: int, device: _Device) -> None:
        super().__init__(cia301.SDO_REQUEST_ID + node_id, cia301.SDO_RESPONSE_ID + node_id, device)
        self._begin(0, 0)

    def _begin(self, index: int, subindex: int) -> None:
        # canopen leaves all of this unset until the first request, and then answers a stray
        # segment or block request with an exception.
        self._index: int = index
        self._subindex: int = subindex
        self._buffer: bytearray = bytearray()
        self._toggle = 0
        self._segments: int | None = None

    def on_request(self, can_id: int, data: bytes, timestamp: float) -> None:
        command = data[0]
        service = command & 0xE0
        try:
            if service == sdo.REQUEST_ABORTED:
                self._begin(0, 0)
            elif service in (sdo.REQUEST_SEGMENT_UPLOAD, sdo.REQUEST_SEGMENT_DOWNLOAD):
                self._segment(service, command, data)
            else:
                self._begin(int.from_bytes(data[1:3], "little"), data[3])
                self._initiate(service, command, data)
        except SdoAbortedError as error:
            self.abort(error.code)

    def abort(self, abort_code: int = sdo.ABORT_GENERAL_ERROR) -> None:
        super().abort(abort_code)
        self._begin(0, 0)

    def _initiate(self, service: int, command: int, data: bytes) -> None:
        """First request of a transfer."""
        # A server may answer a block upload by a normal one (CiA 301, 7.2.4.3.14).
        block_upload = service == sdo.REQUEST_BLOCK_UPLOAD and not command & 0x03
        if service == sdo.REQUEST_UPLOAD or block_upload:
            self.init_upload(data)
            if self._buffer:
                self._segments = sdo.REQUEST_SEGMENT_UPLOAD
        elif service == sdo.REQUEST_DOWNLOAD:
            if not command & sdo.EXPEDITED:
                self._segments = sdo.REQUEST_SEGMENT_DOWNLOAD
            self.init_download(data)
        else:
            raise SdoAbortedError(sdo.ABORT_INVALID_COMMAND_SPECIFIER)

    def _segment(self, service: int, command: int, data: bytes) -> None:
        """A later request of a transfer that takes several."""
        if service != self._segments:
            raise SdoAbortedError(sdo.ABORT_INVALID_COMMAND_SPECIFIER)
        if service == sdo.REQUEST_SEGMENT_UPLOAD:
            self.segmented_upload(command)
            ended = not self._buffer
        else:
            if len(self._buffer) >= DOWNLOAD_BYTES_MAX:
                raise SdoAbortedError(cia301.ABORT_LENGTH)
            self.segmented_download(command, data)
            ended = bool(command & sdo.NO_MORE_DATA)
        if ended:
            self._segments = None


class _Device(canopen.LocalNode):
    """The object dictionary with its rules of access."""

    def __init__(
        self,
        node_id: int,
        dictionary: ObjectDictionary,
        on_write: Callable[[ODVariable, bytes], None],
        on_nmt: Callable[[NmtCommand], None],
    ) -> None:
        super().__init__(node_id, dictionary)
        self.sdo = _Server(node_id, self)
        self.slave = self.nmt = _Slave(node_id, self, on_nmt)
        # Ours first: `nmt.on_write` acts at once, and a rejected write must change nothing.
        self._write_callbacks = [
            lambda index, subindex, od, data: on_write(od, data),
            self.nmt.on_write,
        ]

    def variable(self, index: int, subindex: int) -> ODVariable:
        """The description of an object. Raises SdoAbortedError when there is none."""
        return self._find_object(index, subindex)

    def number(self, index: int, subindex: int = 0) -> int:
        """The present value of a numeric object."""
        value = self.variable(index, subindex).decode_raw(self.get_data(index, subindex))
        assert isinstance(value, int), f"{index:04X}sub{subindex} is a number"
        return value

    def store(self, index: int, subindex: int, value: int) -> None:
        """Set a numeric object from inside, past the rules for clients."""
        data = self.variable(index, subindex).encode_raw(value)
        self.data_store.setdefault(index, {})[subindex] = data

    def _find_object(self, index: int, subindex: int) -> ODVariable:
        # canopen answers any sub-index of a plain variable.
        if subindex and isinstance(self.object_dictionary.get(index), ODVariable):
            raise SdoAbortedError(cia301.ABORT_NO_SUBINDEX)
        found: ODVariable = super()._find_object(index, subindex)
        return found


class CanopenDevice:
    """The CANopen side of any device, sans-I/O: NMT, boot-up, heartbeat, EMCY, SDO server.

    Numeric objects alone may be writable. What a device adds, it overrides: `_refusal`, `_written`,
    `_live` and `_objects_reset`.

    Args:
        node_id: 1 to 127.
        eds: path of an EDS file (CiA 306), or its text.
        required: objects that the EDS must have.

    Attributes:
        acceptance: identifiers the node wants; any other frame given to it is ignored.
        state: INITIALISING until the first step, then what the NMT master made of it.
        bad_frames: NMT and SDO frames of wrong kind or length or with an unknown NMT command.

    Raises:
        ValueError: no such node id, or the EDS is incomplete; the message names it.
        OSError: the EDS file cannot be read.
    """

    def __init__(
        self, node_id: int, eds: str | Path, *, required: Collection[int] = cia301.DEVICE_OBJECTS
    ) -> None:
        if not 1 <= node_id <= cia301.NODE_ID_MAX:
            raise ValueError(f"node id {node_id}; allowed 1 to {cia301.NODE_ID_MAX}")
        self.node_id = node_id
        self.acceptance = frozenset({cia301.NMT_ID, cia301.SDO_REQUEST_ID + node_id})
        self.bad_frames = 0
        self.state = NmtState.INITIALISING
        self._dictionary = _load(eds, node_id, required)
        self._network = _Network()
        self._device = _Device(node_id, self._dictionary, self._check_write, self._obey)
        self._device.add_read_callback(lambda index, subindex, od: self._live(index, subindex))
        self._start_values: list[tuple[int, int, int]] = []
        self._device.associate_network(self._network)
        self._events: list[CanopenEvent] = []
        self._emergencies = schedule.EmergencyQueue()
        self._due_ns = schedule.AT_ONCE_NS

    @property
    def emcy_dropped(self) -> int:
        """Emergencies lost because too many waited."""
        return self._emergencies.dropped

    def describe(self, index: int, subindex: int = 0) -> EdsVariable:
        """What the EDS says of an object, which must exist."""
        return self._device.variable(index, subindex)

    def number(self, index: int, subindex: int = 0) -> int:
        """The present value of a numeric object, which must exist."""
        return self._device.number(index, subindex)

    def members(self, index: int) -> list[int]:
        """The sub-indices of an object: 0 alone for a plain variable; empty without an object."""
        entry = self._dictionary.get(index)
        return [0] if isinstance(entry, ODVariable) else sorted(entry or ())

    def poll_events(self) -> list[CanopenEvent]:
        """What happened since the last call, each event once, oldest first. Ask every step."""
        if not self._events:
            return []
        events, self._events = self._events, []
        return events

    def emergency(
        self, now_ns: int, error_code: int, error_register: int, manufacturer: bytes = b""
    ) -> None:
        """Queue an EMCY; it leaves in the next step that the inhibit time allows.

        None leaves while the node is STOPPED (CiA 301, 7.3.2.2.4): they wait, the oldest dropped.

        Args:
            now_ns: the time of this step.
            error_code: EMCY error code (CiA 301, table 26); 0 is error reset.
            error_register: new value of object 0x1001.
            manufacturer: at most five bytes, padded with zeros.
        """
        self._emergencies.put(schedule.Emergency(error_code, error_register, manufacturer))
        self._device.store(cia301.ERROR_REGISTER, 0, error_register)
        self._due_ns = min(self._due_ns, max(now_ns, self._emergencies.due_ns))

    def step(self, now_ns: int, received: Iterable[Frame] = ()) -> list[Frame]:
        """Take in NMT and SDO frames and return the frames to send now.

        The first step sends the boot-up. Nothing received and nothing due costs next to nothing.
        """
        if not received and now_ns < self._due_ns:
            return []
        network = self._network
        network.now_ns = now_ns
        if self.state is NmtState.INITIALISING:
            self._device.slave.boot()
            self.state = self._device.slave.number
        for frame in received:
            if frame.can_id in self.acceptance:
                self._take(frame)
                self.state = self._device.slave.number
        frames_due, next_ns = network.cyclic.take_due(now_ns)
        network.outbox += frames_due
        self._due_ns = min(next_ns, self._send_emergency())
        frames, network.outbox = network.outbox, []
        return frames

    def _take(self, frame: Frame) -> None:
        """Hand one frame to canopen, after the checks it does not make."""
        data = frame.data
        if frame.kind is not FrameKind.DATA:
            self.bad_frames += 1
        elif frame.can_id == cia301.NMT_ID:
            if len(data) == 2 and data[0] in _NMT_COMMANDS:
                self._network.notify(cia301.NMT_ID, bytearray(data), 0.0)
            else:
                self.bad_frames += 1
        elif len(data) != cia301.SDO_BYTES:
            self.bad_frames += 1
        elif self.state is not NmtState.STOPPED:
            self._network.notify(frame.can_id, bytearray(data), 0.0)

    def _send_emergency(self) -> int:
        """Send the oldest emergency if it may leave; return when the next one may."""
        if self.state is NmtState.STOPPED:
            return schedule.NEVER_NS
        if self._network.now_ns >= self._emergencies.due_ns:
            inhibit_ns = self._device.number(cia301.EMCY_INHIBIT) * cia301.INHIBIT_UNIT_NS
            emergency = self._emergencies.take(self._network.now_ns, inhibit_ns)
            self._device.emcy.send(
                emergency.error_code, emergency.error_register, emergency.manufacturer
            )
        return self._emergencies.due_ns

    def _obey(self, command: NmtCommand) -> None:
        """An NMT command for this node: undo what a reset undoes, and tell the owner."""
        kind = CanopenEventKind.NMT_COMMAND
        if command is NmtCommand.RESET_NODE:
            self._reset_objects(ALL_INDICES)
            self._emergencies.clear()
        elif command is NmtCommand.RESET_COMMUNICATION:
            self._reset_objects(cia301.COMMUNICATION_OBJECTS)
        if command in _RESETS:
            kind = CanopenEventKind.RESET_NODE
        self._events.append(CanopenEvent(kind=kind, command=command))

    def _reset_objects(self, indices: Collection[int]) -> None:
        """Put the objects in `indices` back to their values of construction."""
        store = self._device.data_store
        for index in [index for index in store if index in indices]:
            del store[index]
        for index, subindex, raw in self._start_values:
            if index in indices:
                self._device.store(index, subindex, raw)
        self._objects_reset(indices)

    def _check_write(self, variable: ODVariable, data: bytes) -> None:
        """Rules for clients' writes; existence, access and length have been checked."""
        raw = int(variable.decode_raw(bytes(data)))
        index, subindex = variable.index, variable.subindex
        code = self._refusal(index, subindex, raw)
        if not code and variable.min is not None and raw < variable.min:
            code = cia301.ABORT_TOO_LOW
        if not code and variable.max is not None and raw > variable.max:
            code = cia301.ABORT_TOO_HIGH
        if code:
            raise SdoAbortedError(code)
        self._written(index, subindex, raw)

    def _refusal(self, index: int, subindex: int, raw: int) -> int:
        """Abort code for a client's write, asked before its limits; 0: no objection."""
        return 0

    def _written(self, index: int, subindex: int, raw: int) -> None:
        """A client wrote an object."""

    def _live(self, index: int, subindex: int) -> int | None:
        """The value of an object that the device measures; None: the one that is stored."""
        return None

    def _objects_reset(self, indices: Collection[int]) -> None:
        """The objects in `indices` are back at their values of construction."""


def _load(eds: str | Path, node_id: int, required: Collection[int]) -> ObjectDictionary:
    """The dictionary in an EDS file or text. Raises ValueError naming what is missing."""
    text = str(eds) if "\n" in str(eds) else Path(eds).read_text(encoding="ascii")
    dictionary: ObjectDictionary = import_eds(io.StringIO(text), node_id)
    missing = [f"{index:04X}" for index in required if index not in dictionary]
    if missing:
        raise ValueError(f"EDS of node {node_id}: no object {', '.join(missing)}")
    return dictionary
