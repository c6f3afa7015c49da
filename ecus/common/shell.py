"""What every ECU has around its own logic: bus, CANopen, own timing, codes, events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Final

from canbus.canopen_node import CanopenNode
from canbus.canopen_protocol import (
    NMT_ID,
    CanopenEvent,
    CanopenEventKind,
    NmtCommand,
    NmtState,
    nmt_frame,
)
from canbus.cia402 import identifiers
from canbus.cycle import CycleFault, CycleWatch
from canbus.frame import Frame, ReceivedFrame
from canbus.node import NODE_IDS, Event, EventKind
from dbc.database import configuration_hash, dbc_hash
from dbc.endpoint import Endpoint, Message, is_forged
from dbc.messages import ErrorCode, Mode, Reason
from dbc.strangers import StrangerLog
from ecus.common.codes import (
    EMCY_CODE_BASE,
    EMCY_REGISTER_GENERIC,
    Cause,
    CodeLatch,
    emcy_payload,
)
from vehicles import Vehicle

_OPERATIONAL: Final = NmtState.OPERATIONAL
_LATE_REASON: Final = {CycleFault.LATE: Reason.LATE, CycleFault.OVERRUNS: Reason.OVERRUNS}


def load_eds(name: str) -> str:
    """Text of a node's EDS file."""
    return files("dbc").joinpath("eds", f"{name}.eds").read_text(encoding="utf-8")


class Shell:
    """One node's surroundings; `begin` opens a step, `finish` closes it.

    The NMT master starts itself and obeys nobody: a stranger's command is reported, not obeyed.

    Attributes:
        causes: what was found wrong in this step, in the order of finding.
        written: parameters written by SDO in this step, SI.
        is_reset: an NMT reset was obeyed in this step; all parameters are at their start again.
    """

    def __init__(
        self,
        node: str,
        vehicle: Vehicle,
        eds: str,
        subscribed: Sequence[str],
        parameters: Mapping[str, float],
        *,
        is_nmt_master: bool = False,
    ) -> None:
        self.node = node
        self._is_nmt_master = is_nmt_master
        self._strangers = StrangerLog()
        self.canopen = CanopenNode(
            NODE_IDS[node],
            load_eds(eds),
            dbc_hash=dbc_hash(),
            vehicle_hash=configuration_hash(vehicle.text),
            parameters=parameters,
        )
        self.cycle = CycleWatch()
        self.codes = CodeLatch()
        self.causes: list[Cause] = []
        self.events: list[Event] = []
        self.written: list[CanopenEvent] = []
        self.is_reset = False
        self.now_ns = 0
        self._outbox: list[Frame] = []
        self._has_emergency = False
        self._canopen_ids = self.canopen.acceptance
        if is_nmt_master:
            self._canopen_ids -= {NMT_ID}
        drives = identifiers(vehicle.drive_node_ids)
        self.endpoint = Endpoint(node, subscribed, self._canopen_ids, drives)

    @property
    def acceptance(self) -> frozenset[int]:
        """Identifiers this node wants from the bus."""
        return self.endpoint.acceptance | self._canopen_ids

    @property
    def is_operational(self) -> bool:
        """NMT state OPERATIONAL: only then are process data sent and actuators moved."""
        return self.canopen.state is _OPERATIONAL

    def begin(self, now_ns: int, received: Sequence[ReceivedFrame]) -> list[Message]:
        """Takes in everything since the last step; answers the believable messages."""
        self.now_ns = now_ns
        self.causes, self.events, self.written, self.is_reset = [], [], [], False
        overruns = self.cycle.overruns
        fault = self.cycle.check(now_ns)
        if self.cycle.overruns != overruns:  # each is reported; one alone is no fault
            text = "overrun" if fault is None else fault.value
            self.add_event(EventKind.OVERRUN, f"{text} ({self.cycle.lateness_ns / 1e6:.1f} ms)")
        if fault is not None:
            self.add_cause(ErrorCode.ER2, _LATE_REASON[fault])
        messages = self.endpoint.take(received)
        for_canopen = self.endpoint.handed_on
        if self._is_nmt_master and not self.is_operational:
            for_canopen = [*for_canopen, nmt_frame(NmtCommand.START, self.canopen.node_id)]
        bad_frames = self.canopen.bad_frames
        self._outbox = self.canopen.step(now_ns, for_canopen)
        if self.canopen.bad_frames != bad_frames:
            self.add_cause(ErrorCode.ER0, Reason.BAD_FRAME)
            self.add_event(EventKind.FRAME, "ignored an NMT or SDO frame: malformed")
        self._has_emergency = False
        for event in self.canopen.poll_events():
            self._on_canopen(event)
        if self.endpoint.bad or self.endpoint.foreign or self.endpoint.is_bus_off:
            self._on_bad_traffic()
        return messages

    def _on_canopen(self, event: CanopenEvent) -> None:
        if event.kind is CanopenEventKind.PARAMETER_WRITTEN:
            self.written.append(event)
            self.add_event(EventKind.PARAMETER, f"{event.name} = {event.value:g}")
            return
        assert event.command is not None
        if event.command is NmtCommand.RESET_NODE:  # RESET_COMMUNICATION leaves parameters alone
            self.is_reset = True
            self.written.clear()
        self.add_event(EventKind.NMT, f"obeyed {event.command.name}")
        if event.command is not NmtCommand.START:
            self.add_cause(ErrorCode.ER2, Reason.NMT_COMMAND)

    def _on_bad_traffic(self) -> None:
        for bad in self.endpoint.bad:
            self.add_cause(ErrorCode.ER0, Reason.BAD_FRAME)
            self.add_event(EventKind.FRAME, f"ignored {bad.frame}: {bad.fault.name.lower()}")
        for line in self._strangers.lines(self.now_ns, self.endpoint.foreign):
            self.add_event(EventKind.FOREIGN, line)
        for item in self.endpoint.foreign:
            if is_forged(item.frame):
                self.add_cause(ErrorCode.ER1, Reason.FOREIGN_SENDER)
        if self.endpoint.is_bus_off:
            self.add_cause(ErrorCode.ER2, Reason.BUS_OFF)

    def add_cause(self, code: ErrorCode, reason: Reason, since_ns: int | None = None) -> None:
        """Notes something wrong; `since_ns` is when it began, now if not known better."""
        began_ns = self.now_ns if since_ns is None else since_ns
        self.causes.append(Cause(code=code, reason=reason, seen_ns=began_ns))

    def add_event(self, kind: EventKind, text: str) -> None:
        """Something for the log."""
        self.events.append(Event(time_ns=self.now_ns, node=self.node, kind=kind, text=text))

    def apply_mode(self, mode: Mode | None) -> None:
        """Parameters may be written in MANUAL alone."""
        self.canopen.writable = mode is Mode.MANUAL

    def report(self, *, latch: bool) -> None:
        """Turns this step's causes into codes, each new one with an EMCY and a line in the log."""
        for cause in self.causes:
            is_latching = latch and cause.code is not ErrorCode.ER0
            if self.codes.raise_code(cause.code, self.now_ns, latch=is_latching):
                self.add_event(EventKind.CODE, f"{cause.code.name} {cause.reason.name}")
                self._has_emergency = True
                self.canopen.emergency(
                    self.now_ns,
                    EMCY_CODE_BASE + cause.code,
                    EMCY_REGISTER_GENERIC,
                    emcy_payload(cause, self.codes.reported(self.now_ns)),
                )

    def reset_codes(self) -> None:
        """The supervisor raised the reset epoch: unlatch, and say so (EMCY error reset)."""
        if self.codes.reported(self.now_ns):
            self._has_emergency = True
            self.canopen.emergency(self.now_ns, 0, 0, bytes([ErrorCode.NONE, 0, 0, 0, 0]))
        self.codes.reset()

    def finish(self, frames: list[Frame]) -> list[Frame]:
        """All frames of this step: CANopen's, then the node's own."""
        if self._has_emergency:  # raised in this step: it need not wait for the next
            self._outbox += self.canopen.step(self.now_ns, ())
        return self._outbox + frames
