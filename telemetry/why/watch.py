"""Told every frame of a bus, in order, it tells of incidents: the same for a log and live.

Sans-I/O: `take(time_ns, frame)` and `finish()`. What is remembered is bounded: the frames of the
last seconds, and the incidents whose second after has not passed yet.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from canbus.frame import Frame, FrameKind
from dbc.codec import Decoded, decode
from dbc.endpoint import FAILSAFE_ID, ID_OF_NAME, STOPPING_IDS
from dbc.messages import (
    SPECS,
    ErrorCode,
    Mode,
    Request,
    SafetyVerdict,
    SupervisorState,
    Verdict,
)
from gateway.requests import ENGAGE_PENDING_NS_MAX
from telemetry.why.claims import EMCY_IDS
from telemetry.why.explain import Sign, explain
from telemetry.why.incident import Incident, Kind
from telemetry.why.refusals import Attempt
from telemetry.why.window import QUIET_NS
from vehicles import Vehicle

NS_PER_S: Final = 1_000_000_000
BEFORE_NS: Final = NS_PER_S
AFTER_NS: Final = NS_PER_S
"""An incident is judged by the second before its first sign and the second after."""
KEEP_NS: Final = BEFORE_NS + AFTER_NS + ENGAGE_PENDING_NS_MAX
"""A refused engagement is told when its request has ended."""
FRAMES_MAX: Final = 90_000
"""More than the fastest classical bus (1 Mbit/s, 47 bits the shortest frame) carries meanwhile."""
assert KEEP_NS / 47_000 < FRAMES_MAX
PENDING_MAX: Final = 32
CODE_OFF_NS: Final = 10 * NS_PER_S
"""A code that was not told for so long is a new one when it is told again."""

HEARD_NS: Final = 100_000_000
"""Ten states of the supervisor."""

DRIVING: Final = frozenset({Mode.AUTOMATIC, Mode.STOPPING})
HUMAN: Final = frozenset({Mode.MANUAL, Mode.READY})
STATE_ID: Final = ID_OF_NAME["SUPERVISOR_STATE"]
VERDICT_ID: Final = ID_OF_NAME["SAFETY_VERDICT"]
REQUEST_ID: Final = ID_OF_NAME["MODE_REQUEST"]
HEEDED: Final = STOPPING_IDS | EMCY_IDS | {STATE_ID, VERDICT_ID, REQUEST_ID, FAILSAFE_ID}


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeChange:
    """The driving mode as the bus told it; `before` is None at the beginning."""

    time_ns: int
    before: Mode | None
    after: Mode


@dataclass(frozen=True, slots=True, kw_only=True)
class CodeOnset:
    """An error code that came up, with every frame of the second before and the second after."""

    time_ns: int
    code: ErrorCode
    node: str
    reason: str
    frames: tuple[tuple[int, Frame], ...] = field(repr=False)


Told = Incident | ModeChange | CodeOnset


@dataclass(slots=True)
class _Pending:
    """Something whose second after is still to come."""

    due_ns: int
    sign: Sign | None = None
    onset: CodeOnset | None = None


class Watch:
    """One bus.

    Args:
        vehicle: What its nodes believe about the car.

    Attributes:
        frames: Frames taken.
        known: Of them, with an identifier of ours.
        begin_ns, end_ns: Times of the first and the newest frame.
        mode: The newest driving mode heard; None before the first.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.frames = self.known = 0
        self.begin_ns = self.end_ns = 0
        self.mode: Mode | None = None
        self._vehicle = vehicle
        self._ring: deque[tuple[int, int, Frame]] = deque(maxlen=FRAMES_MAX)
        self._lived_ns = 0
        self._has_ended = False
        self._state_ns = 0
        self._emergency_ns = self._emergency_epoch = 0
        self._pending: deque[_Pending] = deque()
        self._emergency: Sign | None = None
        self._attempt: Attempt | None = None
        self._verdict: SafetyVerdict | None = None
        self._codes_ns: dict[ErrorCode, int] = {}

    def take(self, time_ns: int, frame: Frame) -> Iterator[Told]:
        """One frame; times never go back (one that does counts as of the newest).

        Yields:
            What is complete by now, and every change of the mode at once.
        """
        time_ns = max(time_ns, self.end_ns)
        if not self.frames:
            self.begin_ns = self.end_ns = time_ns
        yield from self._due(time_ns)
        self._keep(time_ns, frame)
        if frame.can_id in HEEDED and frame.kind is FrameKind.DATA:
            decoded = decode(frame)
            if isinstance(decoded, Decoded):
                yield from self._heed(time_ns, frame.can_id, decoded.message)

    def elapse(self, time_ns: int) -> Iterator[Told]:
        """Time has passed and nothing was heard: for a live bus that fell silent."""
        yield from self._due(time_ns)

    def finish(self) -> Iterator[Told]:
        """The log has ended: what is not complete is told as far as it goes."""
        self._has_ended = True
        if self._attempt is not None:
            self._refuse(self._attempt)
        while self._pending:
            yield from self._tell(self._pending.popleft())

    def follow(self, frames: Iterable[tuple[int, Frame]]) -> Iterator[Told]:
        """A whole log, `(time_ns, frame)` each, to its end."""
        for time_ns, frame in frames:
            yield from self.take(time_ns, frame)
        yield from self.finish()

    # The frames ------------------------------------------------------------------------------

    def _keep(self, time_ns: int, frame: Frame) -> None:
        """Remembers a frame. A time in which nothing was heard at all does not push out what was
        heard before it."""
        self._lived_ns += min(time_ns - self.end_ns, QUIET_NS)
        self.end_ns = time_ns
        self.frames += 1
        self.known += frame.can_id in SPECS
        ring = self._ring
        ring.append((self._lived_ns, time_ns, frame))
        while self._lived_ns - ring[0][0] > KEEP_NS:
            ring.popleft()

    def _around(self, time_ns: int) -> list[tuple[int, Frame]]:
        """Frames of the second before and the second after; across a silence, those before it."""
        at_ns = next((lived for lived, at, _ in self._ring if at >= time_ns), self._lived_ns)
        return [
            (at, frame)
            for lived, at, frame in self._ring
            if at_ns - lived <= BEFORE_NS and at <= time_ns + AFTER_NS
        ]

    def _due(self, time_ns: int) -> Iterator[Told]:
        if self._attempt is not None and self._attempt.is_over(time_ns):
            self._refuse(self._attempt)
        while self._pending and self._pending[0].due_ns < time_ns:
            yield from self._tell(self._pending.popleft())

    def _tell(self, item: _Pending) -> Iterator[Told]:
        if item.onset is not None:
            onset = item.onset
            yield CodeOnset(
                time_ns=onset.time_ns, code=onset.code, node=onset.node, reason=onset.reason,
                frames=tuple(self._around(onset.time_ns)),
            )
        elif item.sign is not None:
            is_heard = self.end_ns - self._state_ns < HEARD_NS
            if item.sign is self._emergency and self.mode in DRIVING and is_heard:
                self._emergency = None  # nobody obeyed it
            frames = self._around(item.sign.time_ns)
            yield explain(item.sign, frames, self._vehicle, is_cut=self._has_ended)

    # What is heeded --------------------------------------------------------------------------

    def _heed(self, time_ns: int, can_id: int, message: object) -> Iterator[Told]:
        if can_id == STATE_ID:
            assert isinstance(message, SupervisorState)
            yield from self._on_state(time_ns, message)
            return
        self._note_codes(time_ns, can_id, message)
        if can_id == REQUEST_ID:
            self._on_request(time_ns, message)
        elif can_id == VERDICT_ID:
            assert isinstance(message, SafetyVerdict)
            self._verdict = message
            if message.verdict is Verdict.BRAKE and self.mode in DRIVING:
                self._begin_emergency(time_ns, self.mode)
        elif (can_id in STOPPING_IDS and self.mode not in HUMAN) or (
            can_id == FAILSAFE_ID and self.mode is not Mode.MANUAL
        ):
            self._begin_emergency(time_ns, self.mode)

    def _on_state(self, time_ns: int, state: SupervisorState) -> Iterator[Told]:
        if self._attempt is not None:
            self._attempt.hear(time_ns, state, self._verdict)
            if state.mode in DRIVING:
                self._attempt = None
        self._state_ns = time_ns
        if self.mode is Mode.EMERGENCY and not self._may_leave_emergency(time_ns, state):
            return
        if state.mode is Mode.EMERGENCY:
            self._emergency_ns, self._emergency_epoch = time_ns, state.reset_epoch
        before, self.mode = self.mode, state.mode
        if before is state.mode:
            return
        yield ModeChange(time_ns=time_ns, before=before, after=state.mode)
        if state.mode is Mode.EMERGENCY or (before in DRIVING and state.mode is Mode.INIT):
            self._begin_emergency(time_ns, before)
        elif before in DRIVING and state.mode not in DRIVING | {Mode.INIT}:
            is_end = before is Mode.STOPPING and state.mode is Mode.READY
            if self._emergency is None and not is_end:
                self._begin(Kind.DISENGAGEMENT, time_ns, before)
        elif before is Mode.AUTOMATIC and state.mode is Mode.STOPPING:
            self._begin(Kind.DISENGAGEMENT, time_ns, before)
        if state.mode in HUMAN:
            self._emergency = None

    def _may_leave_emergency(self, time_ns: int, state: SupervisorState) -> bool:
        """It is left by a reset alone: another mode beside it is a stranger's."""
        is_reset = state.mode is Mode.MANUAL and state.reset_epoch != self._emergency_epoch
        was_heard = time_ns - self._emergency_ns < HEARD_NS
        return state.mode is Mode.EMERGENCY or is_reset or not was_heard

    def _begin(self, kind: Kind, time_ns: int, before: Mode | None) -> Sign:
        sign = Sign(kind=kind, time_ns=time_ns, mode_before=before)
        self._wait(_Pending(time_ns + AFTER_NS, sign=sign))
        return sign

    def _begin_emergency(self, time_ns: int, before: Mode | None) -> None:
        """The first sign of one; it takes the place of a mode that was told a moment before."""
        if self._emergency is not None:
            return
        recent = [item for item in self._pending if item.sign is not None]
        for item in recent:
            sign = item.sign
            assert sign is not None
            if sign.kind is Kind.DISENGAGEMENT and time_ns - sign.time_ns <= QUIET_NS:
                self._pending.remove(item)
                time_ns, before = sign.time_ns, sign.mode_before
        self._emergency = self._begin(Kind.EMERGENCY_BRAKE, time_ns, before)

    def _wait(self, item: _Pending) -> None:
        if len(self._pending) < PENDING_MAX:
            place = len(self._pending)
            while place and self._pending[place - 1].due_ns > item.due_ns:
                place -= 1
            self._pending.insert(place, item)

    # Engaging --------------------------------------------------------------------------------

    def _on_request(self, time_ns: int, message: object) -> None:
        request, sequence = getattr(message, "request", None), getattr(message, "sequence", 0)
        attempt = self._attempt
        if attempt is not None and (request is not Request.ENGAGE or sequence != attempt.sequence):
            self._refuse(attempt)
            attempt = None
        if request is not Request.ENGAGE or self.mode in DRIVING:
            return
        if attempt is None:
            attempt = self._attempt = Attempt(time_ns, sequence, self.mode)
        attempt.last_ns = time_ns

    def _refuse(self, attempt: Attempt) -> None:
        self._attempt = None
        sign = Sign(
            kind=Kind.REFUSED_ENGAGEMENT, time_ns=attempt.begin_ns, mode_before=attempt.mode,
            refusals=tuple(attempt.refusals),
        )
        self._wait(_Pending(self.end_ns, sign=sign))

    # Codes -----------------------------------------------------------------------------------

    def _note_codes(self, time_ns: int, can_id: int, message: object) -> None:
        """A code that an EMCY or an EMERGENCY_BRAKE tells, and that was not told lately."""
        if can_id in STOPPING_IDS:
            code = getattr(message, "code", ErrorCode.NONE)
        elif can_id in EMCY_IDS:
            code = getattr(message, "er_code", ErrorCode.NONE)
        else:
            return
        if code is ErrorCode.NONE:
            return
        before_ns = self._codes_ns.get(code)
        self._codes_ns[code] = time_ns
        if before_ns is None or time_ns - before_ns > CODE_OFF_NS:
            reason = getattr(message, "reason", None)
            onset = CodeOnset(
                time_ns=time_ns, code=code, node=SPECS[can_id].sender or "",
                reason="" if reason is None else reason.name, frames=(),
            )
            self._wait(_Pending(time_ns + AFTER_NS, onset=onset))
