"""The oracle: hears the wire, sees the truth, knows the faults, and keeps what was broken."""

from __future__ import annotations

from typing import Final

from canbus.frame import Frame
from oracle.braking import (
    BrakeKept,
    NoDriveWhileBraking,
    NoFalseEmergency,
    RegenerationReplacesServo,
)
from oracle.commands import NoOldDecision, OnlyIntactCommandsApplied, PathBounded
from oracle.decode import Channel, node_names
from oracle.driver import (
    DriverSteersInEmergency,
    DriverWins,
    NothingMovesUnderDriver,
    RelayOpenUnderDriver,
    SteeringCoasts,
)
from oracle.drives import drive_owners
from oracle.engaging import EngagedInOrder, StartsUp
from oracle.hazards import HazardAnswered, HazardEndsBraked
from oracle.latches import CodesLatched, EmergencyLatched
from oracle.modes import Authorisation, ModeOrder
from oracle.nodes import OneSender, RejoinsByRearming
from oracle.property import Property
from oracle.report import Corruptions, OracleReport, Violation
from oracle.reverse import TurnsRoundStanding
from oracle.sample import Sample
from oracle.scene import CYCLIC, OF_SCENE, Fault, Scene
from oracle.settings import HAZARD_NS, Settings
from vehicles import Vehicle

PROPERTIES: Final[tuple[type[Property], ...]] = (
    HazardAnswered,
    HazardEndsBraked,
    NoDriveWhileBraking,
    BrakeKept,
    RegenerationReplacesServo,
    NoFalseEmergency,
    SteeringCoasts,
    DriverWins,
    DriverSteersInEmergency,
    RelayOpenUnderDriver,
    NothingMovesUnderDriver,
    ModeOrder,
    Authorisation,
    EngagedInOrder,
    StartsUp,
    CodesLatched,
    EmergencyLatched,
    RejoinsByRearming,
    OneSender,
    OnlyIntactCommandsApplied,
    NoOldDecision,
    TurnsRoundStanding,
    PathBounded,
)
"""All of them, in the order in which they look."""

ALTERED: Final = "altered"
"""Sender of what was changed on its way and fits its CRC-8 all the same: no node said it."""

WATCHED: Final = frozenset((*OF_SCENE, *CYCLIC)).union(*(kind.watches for kind in PROPERTIES))
"""Messages that are decoded at all."""
BATCH: Final = 200
"""Frames and looks that are judged together, about 0.2 s: judged one by one, between the steps of
nodes and plant, they would cost twice the time (the processor's caches)."""
KEPT_MAX: Final = 5
"""Violations of one property that are kept in words; the rest are counted."""
FREE_FOR_ALL: Final = frozenset({"FAILSAFE"})
NO_EXCUSE: Final[frozenset[str]] = frozenset()


class Oracle:
    """Judges one world. Attach `on_frame` to its wire, and call the others as things happen.

    Times are true times and never go back. The order at one instant: what is done to the world
    (`on_fault`), then what is seen.
    """

    def __init__(self, vehicle: Vehicle, settings: Settings | None = None) -> None:
        self.settings = settings or Settings.of(vehicle)
        self.scene = Scene(self.settings)
        self._violations: list[Violation] = []
        self._excused: list[Violation] = []
        self._counts: dict[str, int] = {}
        by_name = self.scene.channels
        self._channels = {channel.can_id: channel for channel in by_name.values()}
        self._drive_owners = drive_owners(vehicle)
        self._nodes = node_names().union(self._drive_owners.values())
        self._pending: list[Sample | tuple[int, str, Frame]] = []
        self._strangers = 0
        self._corruptions = 0
        self._unseen = 0
        self._altered: set[tuple[int, bytes]] = set()
        self._ids_of_scene = frozenset(by_name[name].can_id for name in OF_SCENE)
        properties = [kind(self.scene, self.settings, self._complain) for kind in PROPERTIES]
        one_sender = next(p for p in properties if isinstance(p, OneSender))
        self._on_other = one_sender.on_other
        self._watchers = {
            channel.can_id: tuple(p.on_message for p in properties if name in p.watches)
            for name, channel in by_name.items()
            if name in WATCHED
        }
        self._on_sample = tuple(
            p.on_sample for p in properties if type(p).on_sample is not Property.on_sample
        )
        self._on_fault = tuple(
            p.on_fault for p in properties if type(p).on_fault is not Property.on_fault
        )

    # What happens ----------------------------------------------------------------------------

    def on_frame(self, true_ns: int, sender: str, frame: Frame) -> None:
        """A frame has gone through; `sender` is the true station's name."""
        self._pending.append((true_ns, sender, frame))

    def _judge_frame(self, true_ns: int, sender: str, frame: Frame) -> None:
        can_id = frame.can_id
        channel = self._channels.get(can_id)
        if channel is None or channel.sender != sender:
            self._check_sender(true_ns, sender, frame, channel)
            if channel is None:
                return
        watchers = self._watchers.get(can_id)
        if watchers is None:
            return
        if self._altered and (can_id, frame.data) in self._altered:
            self._altered.remove((can_id, frame.data))
            sender = ALTERED
        message = channel.hear(true_ns, sender, frame)
        if not channel.is_news:
            return
        if can_id in self._ids_of_scene or not message.is_genuine:
            self.scene.on_message(true_ns, message)
        for watch in watchers:
            watch(true_ns, message)

    def _check_sender(
        self, true_ns: int, sender: str, frame: Frame, channel: Channel | None
    ) -> None:
        if sender not in self._nodes:
            self._strangers += 1
        elif channel is None or channel.name not in FREE_FOR_ALL:
            owner = channel.sender if channel else self._drive_owners.get(frame.can_id)
            if owner == sender:
                return
            self._on_other(true_ns, frame.can_id, sender, owner)

    def on_corruption(self, sender: str, sent: Frame, heard: Frame) -> None:
        """A frame was changed on its way; what was heard is told by `on_frame` as well."""
        channel = self._channels.get(sent.can_id)
        if channel is None or sent == heard:
            return
        self._corruptions += 1
        is_alike = heard.can_id == sent.can_id and heard.kind is sent.kind
        if is_alike and channel.is_intact(heard.data):
            self._unseen += 1
            self._altered.add((heard.can_id, heard.data))

    def on_truth(self, sample: Sample) -> None:
        """A look at the truth: every 10 ms, and after every change of what the driver does."""
        self._pending.append(sample)
        if len(self._pending) >= BATCH:
            self.judge()

    def _judge_sample(self, sample: Sample) -> None:
        now_ns = sample.true_ns
        self.scene.on_sample(now_ns, sample)
        for look in self._on_sample:
            look(now_ns, sample)

    def judge(self) -> None:
        """Judges what has been told and not been judged yet."""
        pending, self._pending = self._pending, []
        for entry in pending:
            if isinstance(entry, Sample):
                self._judge_sample(entry)
            else:
                self._judge_frame(entry[0], entry[1], entry[2])

    def on_fault(
        self,
        true_ns: int,
        kind: str,
        target: str,
        is_begin: bool,
        *,
        budget_ns: int | None = HAZARD_NS,
        may_stop: bool = True,
        excuses: frozenset[str] = NO_EXCUSE,
        is_planners: bool = False,
    ) -> None:
        """Something breaks, or is whole again; `kind` and `target` say which.

        Args:
            true_ns: When.
            kind: What, in the injector's words.
            target: Of which node or part.
            is_begin: False when it ends.
            budget_ns: Its fault-tolerant time: within it the brake is called, if the car drives
                itself when it begins. None: it need not be answered.
            may_stop: False if not even an emergency brake may follow from it.
            excuses: Names of properties that do not hold under this fault, by design. What breaks
                them while it is there, or was lately, is reported apart.
            is_planners: Nothing but the planner's decisions is missing.
        """
        self.judge()
        fault = Fault(
            kind=kind, target=target, true_ns=true_ns, budget_ns=budget_ns, may_stop=may_stop,
            excuses=excuses, is_planners=is_planners,
        )
        assert excuses <= {p.name for p in PROPERTIES}, f"unknown properties in {excuses}"
        self.scene.on_fault(true_ns, fault, is_begin=is_begin)
        for react in self._on_fault:
            react(true_ns, fault, is_begin=is_begin)

    def finish(self, true_ns: int) -> OracleReport:
        """What was found until now."""
        self.judge()
        return OracleReport(
            violations=tuple(self._violations),
            excused=tuple(self._excused),
            counts=dict(self._counts),
            reactions=tuple(hazard.reaction() for hazard in self.scene.hazards),
            strangers=self._strangers,
            corruptions=Corruptions(count=self._corruptions, unseen=self._unseen),
        )

    def _complain(self, name: str, true_ns: int, text: str) -> None:
        excuse = self.scene.excuse(true_ns, name)
        if excuse is not None:
            text = f"{text} ({excuse.kind} of {excuse.target})"
            self._excused.append(Violation(property=name, true_ns=true_ns, text=text))
            return
        count = self._counts[name] = self._counts.get(name, 0) + 1
        if count <= KEPT_MAX:
            self._violations.append(Violation(property=name, true_ns=true_ns, text=text))
