"""What has happened so far, as every property needs it: mode, brake, drive, faults, truth.

Only what the true senders said counts here: a stranger deceives the nodes, not the oracle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from oracle.decode import Message, channels
from oracle.hazard import Hazard
from oracle.sample import Sample
from oracle.settings import Settings
from oracle.words import (
    BRAKE_FRAMES,
    DRIVING,
    HEARTBEATS,
    HUMAN,
    NEVER_NS,
    NS_PER_MS,
    HeartbeatState,
    Mode,
    NmtCommand,
    Request,
)

MODES: Final = dict(enumerate(Mode))
UNHEARD_NS: Final = 200 * NS_PER_MS
"""After such a gap what is heard may tell of what happened within it."""

OF_SCENE: Final = (
    "FAILSAFE", "NMT", "SUPERVISOR_STATE", "MODE_REQUEST", *BRAKE_FRAMES, *HEARTBEATS
)
"""Messages that the scene itself needs."""
CYCLIC: Final = tuple(channel.name for channel in channels().values() if channel.timeout_ns)
"""Messages that show who lives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """What the injector has broken.

    Attributes:
        kind: In its own words.
        target: Of which node or part.
        true_ns: Since when.
        budget_ns: Within which the emergency brake must be called; None: it need not be.
        may_stop: Whether it is a reason for an emergency brake at all.
        excuses: Names of the properties that this fault is beyond.
        is_planners: Nothing but the planner's decisions is missing: a controlled stop needs none.
    """

    kind: str
    target: str
    true_ns: int
    budget_ns: int | None
    may_stop: bool
    excuses: frozenset[str]
    is_planners: bool = False


class Scene:
    """The common past. The oracle writes it before any property looks.

    Attributes:
        sample: The newest look at the truth.
        mode: The supervisor's newest word.
        mode_since_ns: When it was first heard.
        epoch: Its reset epoch.
        decision_limit_ns: Oldest decision that may be obeyed, by its word.
        drive: Number of the drive; a new one begins with every AUTOMATIC.
        braking_since_ns: When the emergency brake was called, until a human has the car again.
        channels: By the messages' names, what was last heard of them.
        booted_ns: By node, when its boot-up was last heard.
        faults: What is broken now.
        hazards, open_hazards: What called for the brake in a drive; those not at their end yet.
        cause_ns: When there was last a reason for an emergency brake.
        cause: Which.
    """

    def __init__(self, settings: Settings) -> None:
        self._memory_ns = settings.memory_ns
        self._is_touch_a_hazard = settings.is_touch_a_hazard
        self.sample = Sample()
        self.mode = Mode.INIT
        self.mode_since_ns = NEVER_NS
        self.epoch = 0
        self.decision_limit_ns = 0
        self.drive = 0
        self.braking_since_ns: int | None = None
        self.channels = channels()
        self.booted_ns: dict[str, int] = {}
        self.faults: dict[tuple[str, str], Fault] = {}
        self.hazards: list[Hazard] = []
        self.open_hazards: list[Hazard] = []
        self._ended: list[tuple[int, Fault]] = []
        self.cause_ns = NEVER_NS
        self.cause = "nothing"
        self.fault_ns = NEVER_NS
        self._state = self.channels["SUPERVISOR_STATE"]
        self._reactions: dict[str, Callable[[int, Message], None]] = {
            "SUPERVISOR_STATE": self._on_state,
            "MODE_REQUEST": self._on_request,
            "NMT": lambda now_ns, message: None,  # the master's own
            **dict.fromkeys(BRAKE_FRAMES, self._on_brake),
            **dict.fromkeys(HEARTBEATS, self._on_heartbeat),
        }

    @property
    def is_driving(self) -> bool:
        """The car drives itself."""
        return self.mode in DRIVING

    def is_disturbed(self, now_ns: int) -> bool:
        """Whether something is broken, or was lately."""
        return bool(self.faults) or now_ns - self.fault_ns <= self._memory_ns

    def has_cause(self, now_ns: int) -> bool:
        """Whether there is a reason for an emergency brake, or was lately."""
        is_present = any(fault.may_stop for fault in self.faults.values())
        return is_present or now_ns - self.cause_ns <= self._memory_ns

    def excuse(self, now_ns: int, name: str) -> Fault | None:
        """A fault, present or lately, that the property of this name does not cover."""
        lately = [fault for end_ns, fault in self._ended if now_ns - end_ns <= self._memory_ns]
        every = (*self.faults.values(), *lately)
        return next((fault for fault in every if name in fault.excuses), None)

    def was_unheard(self, now_ns: int) -> bool:
        """Whether states of the supervisor are missing just before those that are heard now."""
        return now_ns - self._state.resumed_ns <= UNHEARD_NS

    def note_cause(self, now_ns: int, cause: str) -> None:
        """A reason for an emergency brake."""
        self.cause_ns = now_ns
        self.cause = cause

    # What happens ----------------------------------------------------------------------------

    def on_fault(self, now_ns: int, fault: Fault, *, is_begin: bool) -> None:
        """Something breaks, or is whole again."""
        key = fault.kind, fault.target
        if is_begin:
            self.faults[key] = fault
        else:
            fault = self.faults.pop(key, fault)
            self._ended = [
                (end_ns, other)
                for end_ns, other in self._ended
                if now_ns - end_ns <= self._memory_ns
            ]
            self._ended.append((now_ns, fault))
        self.fault_ns = now_ns
        if fault.may_stop:
            self.note_cause(now_ns, f"{fault.kind} of {fault.target}")

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """A look at the truth."""
        self.sample = sample
        if sample.emergency_stop_pressed:
            self.note_cause(now_ns, "the emergency stop")

    def on_touch(self, now_ns: int) -> None:
        """The driver touches a control."""
        if self._is_touch_a_hazard:
            self.note_cause(now_ns, "the driver")

    def on_message(self, now_ns: int, message: Message) -> None:
        """A frame of `OF_SCENE`, or a stranger's with an identifier of ours."""
        name = message.name
        if message.is_genuine and message.values:
            self._reactions[name](now_ns, message)
        elif name == "FAILSAFE":
            self.note_cause(now_ns, f"FAILSAFE of {message.sender}")
        elif message.values:
            self._on_stranger(now_ns, message)

    def _on_brake(self, now_ns: int, message: Message) -> None:
        if self.mode not in HUMAN and self.braking_since_ns is None:
            self.braking_since_ns = now_ns

    def _on_request(self, now_ns: int, message: Message) -> None:
        if message.values["request"] == Request.EMERGENCY_STOP:
            self.note_cause(now_ns, "the planner's request")

    def _on_stranger(self, now_ns: int, message: Message) -> None:
        """A forged frame, or an NMT command of somebody who is not the master."""
        is_start = message.name == "NMT" and message.values["command"] == NmtCommand.START
        if not is_start:
            self.note_cause(now_ns, f"{message.name} of {message.sender}")

    def _on_state(self, now_ns: int, message: Message) -> None:
        values = message.values
        mode = MODES[int(values["mode"])]
        self.epoch = int(values["reset_epoch"])
        self.decision_limit_ns = int(values["decision_age_ms_max"] * 1e6)
        if mode is Mode.EMERGENCY:
            if self.braking_since_ns is None:
                self.braking_since_ns = now_ns
        elif mode in HUMAN:
            self.braking_since_ns = None
        if mode is not self.mode:
            if mode in DRIVING and self.mode not in DRIVING:
                self.drive += 1
            self.mode = mode
            self.mode_since_ns = now_ns

    def _on_heartbeat(self, now_ns: int, message: Message) -> None:
        if message.values["state"] == HeartbeatState.BOOT_UP:
            self.booted_ns[message.sender] = now_ns
