"""What a run's faults were answered with, and how much of it the car drove itself."""

from __future__ import annotations

from typing import Final

from campaign.expectation import SILENT_MS, Expectation, expected, grip_share
from campaign.result import Demand, InjectionResult, ViolationResult
from canbus.frame import Frame
from dbc.codec import Decoded, decode
from dbc.endpoint import ID_OF_NAME
from dbc.messages import ErrorCode, Mode
from oracle.judge import Oracle
from oracle.report import Reaction
from oracle.settings import DRIVER_WINS_FAULTY_NS, MEMORY_NS
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from simulation.world import World

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
LOOK_NS: Final = 50_000_000
LOOK_PRIORITY: Final = 4
SILENT_NS: Final = 100_000_000
"""A supervisor that was not heard for so long drives nothing."""
RECOVERS = "drives again after the faults"
TOUCH_LATE_MS: Final = DRIVER_WINS_FAULTY_NS / NS_PER_MS
DRIVING = frozenset({Mode.AUTOMATIC, Mode.STOPPING})
HUMAN = frozenset({Mode.INIT, Mode.MANUAL, Mode.READY})
STATE_ID: Final = ID_OF_NAME["SUPERVISOR_STATE"]


class Entry:
    """One injected fault, and what came after it."""

    __slots__ = ("ask", "began_ns", "brake_ns", "budget_ms", "code", "fault", "human_ns",
                 "is_clean", "is_driving", "said")

    def __init__(
        self, fault: Fault, ask: Expectation, began_ns: int, *, is_driving: bool, is_clean: bool
    ) -> None:
        self.fault = fault
        self.ask = ask
        self.budget_ms = ask.budget_ms
        self.began_ns = began_ns
        self.is_driving = is_driving
        self.is_clean = is_clean
        self.brake_ns: int | None = None
        self.human_ns: int | None = None
        self.code = ""
        self.said = ""

    def result(self, reaction: Reaction | None) -> InjectionResult:
        """As the campaign tells it; `reaction` is the oracle's, of a hazard."""
        latency_ms, is_due, is_missed = self._judged(reaction)
        fault = self.fault
        return InjectionResult(
            kind=str(fault.kind), target=fault.target, at_s=fault.at_s, for_s=fault.for_s,
            value=fault.value, share=fault.share, demand=self.ask.demand,
            budget_ms=self.budget_ms, is_clean=self.is_clean, is_due=is_due,
            latency_ms=latency_ms, code=self.code or self.said,
            is_detected=bool(self.code or self.said) or latency_ms is not None,
            is_missed=is_missed,
        )

    def _judged(self, reaction: Reaction | None) -> tuple[float | None, bool, bool]:
        brake_ms, human_ms = self._since_ms(self.brake_ns), self._since_ms(self.human_ns)
        if self.ask.demand is Demand.BRAKE:
            if reaction is None or reaction.is_moot:
                return brake_ms, False, False
            answers = (reaction.emergency_ms, reaction.setpoint_ms)
            first_ms = min((ms for ms in answers if ms is not None), default=None)
            return first_ms, True, reaction.is_missed
        if self.ask.demand is Demand.HANDOVER:
            assert self.budget_ms is not None
            is_due = self.is_driving and (brake_ms is None or brake_ms > self.budget_ms)
            is_late = human_ms is None or human_ms > self.budget_ms
            return human_ms, is_due, is_due and is_late
        if not self.is_clean:
            return None, False, False
        return brake_ms, False, self.ask.demand is Demand.GO_ON and brake_ms is not None

    def _since_ms(self, time_ns: int | None) -> float | None:
        return None if time_ns is None else (time_ns - self.began_ns) / NS_PER_MS


class Ledger:
    """Hears the wire, is told of faults, and adds up.

    Args:
        world: At its beginning.
        oracle: Told of every fault, with what it asks for.

    Attributes:
        engaged_s, calm_s, stops, repairs_s: As in `campaign.result.SeedResult`.
        violations: Of the campaign's own property.
    """

    def __init__(self, world: World, oracle: Oracle) -> None:
        self.engaged_s = self.calm_s = 0.0
        self.stops = 0
        self.repairs_s: list[float] = []
        self.violations: list[ViolationResult] = []
        self._world = world
        self._oracle = oracle
        self._grip = grip_share(oracle.settings)
        self._entries: list[Entry] = []
        self._open: list[Entry] = []
        self._active = 0
        self._quiet_ns = world.now_ns - MEMORY_NS - 1
        self._mode = Mode.INIT
        self._heard_ns = -SILENT_NS
        self._is_braking = False
        self._down_ns: int | None = None
        self._recovery_s: float | None = None
        world.wire.witnesses.append(self._hear)
        world.kernel.at(world.now_ns, LOOK_PRIORITY, self._look)

    @property
    def _is_driving(self) -> bool:
        is_heard = self._world.now_ns - self._heard_ns <= SILENT_NS
        return self._mode in DRIVING and is_heard and not self._is_braking

    # Faults ----------------------------------------------------------------------------------

    def on_fault(self, now_ns: int, fault: Fault, is_begin: bool) -> None:
        """A listener of the injector."""
        ask = expected(fault, self._grip)
        is_calm = not self._active and now_ns - self._quiet_ns > MEMORY_NS
        is_driving = self._is_driving
        entry = Entry(
            fault, ask, now_ns, is_driving=is_driving and self._is_felt(fault),
            is_clean=is_calm and is_driving,
        )
        if entry.budget_ms is not None and not is_calm:
            entry.budget_ms = max(entry.budget_ms, SILENT_MS)
            if ask.demand is Demand.HANDOVER:
                entry.budget_ms = TOUCH_LATE_MS
        is_hazard = ask.demand is Demand.BRAKE and entry.budget_ms is not None
        self._oracle.on_fault(
            now_ns, str(fault.kind), fault.target, is_begin,
            budget_ns=round((entry.budget_ms or 0.0) * NS_PER_MS) if is_hazard else None,
            may_stop=ask.demand is not Demand.GO_ON, excuses=ask.excuses,
            is_planners=ask.is_planners,
        )
        self._active += 1 if is_begin else -1
        self._quiet_ns = now_ns
        self._recovery_s = max(ask.recovery_s, self._recovery_s or 0.0)
        if is_begin:
            for other in self._open:
                other.is_clean &= other.brake_ns is not None  # what follows may be the new one's
            self._entries.append(entry)
            self._open.append(entry)

    def _is_felt(self, fault: Fault) -> bool:
        """A foot on a pedal that the servo has pushed down as far moves nothing."""
        is_foot = fault.kind is FaultKind.DRIVER_GRABS and fault.target == "brake"
        servo_ratio = self._world.car.truth.servo_position_ratio
        return not is_foot or fault.value - servo_ratio >= self._grip

    def results(self, reactions: tuple[Reaction, ...]) -> tuple[InjectionResult, ...]:
        """One for each fault, beside the oracle's word about the hazardous ones."""
        by_key = {(item.kind, item.target, item.true_ns): item for item in reactions}
        return tuple(
            entry.result(by_key.get((str(entry.fault.kind), entry.fault.target, entry.began_ns)))
            for entry in self._entries
        )

    # The wire --------------------------------------------------------------------------------

    def _hear(self, now_ns: int, sender: str, frame: Frame) -> None:
        can_id = frame.can_id
        if can_id == STATE_ID:
            if sender == "Supervisor":
                self._on_state(now_ns)
        elif can_id <= 0x86 and self._open and sender in self._world.stations:
            if 0x10 < can_id <= 0x16:
                self._on_brake(now_ns, frame)
            elif can_id > 0x80:
                self._on_emcy(frame)

    def _on_state(self, now_ns: int) -> None:
        mode: Mode = self._world.stations["Supervisor"].node.mode
        self._heard_ns = now_ns
        before, self._mode = self._mode, mode
        if mode is before:
            return
        if mode in HUMAN:
            self._is_braking = False
            for entry in self._open:
                if entry.human_ns is None and before in DRIVING:
                    entry.human_ns = now_ns
        if before in DRIVING and mode not in DRIVING and mode is not Mode.READY:
            self._down_ns = now_ns
            self.stops += mode is Mode.EMERGENCY
        elif mode in DRIVING and self._down_ns is not None:
            self.repairs_s.append((now_ns - self._down_ns) / NS_PER_S)
            self._down_ns = None

    def _on_brake(self, now_ns: int, frame: Frame) -> None:
        if self._is_braking or self._mode in HUMAN:
            return
        self._is_braking = True
        decoded = decode(frame)
        text = "EMERGENCY_BRAKE"
        if isinstance(decoded, Decoded):
            text = f"{decoded.message.code.name} {decoded.message.reason.name}"
        for entry in self._open:
            if entry.brake_ns is None:
                entry.brake_ns, entry.code = now_ns, text

    def _on_emcy(self, frame: Frame) -> None:
        decoded = decode(frame)
        if not isinstance(decoded, Decoded) or decoded.message.er_code is ErrorCode.NONE:
            return
        for entry in self._open:
            entry.said = entry.said or decoded.message.er_code.name

    # Time ------------------------------------------------------------------------------------

    def _look(self, now_ns: int) -> None:
        self._world.kernel.at(now_ns + LOOK_NS, LOOK_PRIORITY, self._look)
        quiet_ns = 0 if self._active else now_ns - self._quiet_ns
        is_quiet = quiet_ns > MEMORY_NS
        if is_quiet and self._open:
            self._open = []
        if self._is_driving:
            self.engaged_s += LOOK_NS / NS_PER_S
            self.calm_s += LOOK_NS / NS_PER_S * is_quiet
            if not self._active:
                self._recovery_s = None
        elif self._recovery_s is not None and quiet_ns > self._recovery_s * NS_PER_S:
            supervisor = self._world.stations["Supervisor"].node
            text = f"{supervisor.mode.name} {self._recovery_s:g} s after the faults"
            self._recovery_s = None
            self.violations.append(
                ViolationResult(property=RECOVERS, at_s=now_ns / NS_PER_S, text=text)
            )

