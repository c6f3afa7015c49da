"""The other nodes as the supervisor sees them: alive, started, rightly configured, healthy."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Final

from canbus.canopen_protocol import (
    CONFIGURATION,
    NmtCommand,
    SdoClient,
    nmt_frame,
)
from canbus.frame import Frame, ReceivedFrame
from canbus.node import NODE_IDS
from dbc.endpoint import Endpoint, Message
from dbc.messages import (
    BrakeDriver,
    ErrorCode,
    HeartbeatState,
    NodeState,
    SteerDriver,
    ThrottleDriver,
)
from ecus.common.codes import ER_CODES, NO_CODES

OTHERS: Final = tuple(name for name in NODE_IDS if name != "Supervisor")
"""Nodes 2 to 6, in the order in which their trouble is told."""

ACTUATORS: Final = {"Steering": "STEER", "Throttle": "THROTTLE", "BrakeServo": "BRAKE"}
"""Actuator nodes and their prefix in the DBC's messages."""

LIVENESS: Final = {
    "Steering": ("STEER_STATUS", "STEER_DRIVER"),
    "Throttle": ("THROTTLE_STATUS", "THROTTLE_DRIVER"),
    "BrakeServo": ("BRAKE_STATUS", "BRAKE_DRIVER"),
    "SafetyMonitor": ("SAFETY_VERDICT",),
    "Gateway": ("STEER_COMMAND", "THROTTLE_COMMAND", "BRAKE_COMMAND"),
}
"""Protected frames by which each node shows that it lives."""

DRIVER_FRAMES: Final = {name: f"{prefix}_DRIVER" for name, prefix in ACTUATORS.items()}
DriverMessage = SteerDriver | ThrottleDriver | BrakeDriver

HEARTBEATS: Final = {
    "Steering": "STEER_HEARTBEAT",
    "Throttle": "THROTTLE_HEARTBEAT",
    "BrakeServo": "BRAKE_HEARTBEAT",
    "SafetyMonitor": "SAFETY_MONITOR_HEARTBEAT",
    "Gateway": "GATEWAY_HEARTBEAT",
}

START_INTERVAL_NS: Final = 200_000_000
"""A node or drive that is not OPERATIONAL is told to start at most this often."""

ASK_INTERVAL_NS: Final = 200_000_000
"""A node that does not tell its configuration is asked at most this often."""

RESET_BLOCKING: Final = frozenset({ErrorCode.ER1, ErrorCode.ER2, ErrorCode.ER4, ErrorCode.ER6})
"""Codes whose cause must be gone before a reset. ER0 and ER3 do not brake; ER5 ends by itself."""


class NodeWatch:
    """What is known of one node."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.node_id = NODE_IDS[name]
        self.nmt: HeartbeatState | None = None
        self.has_booted = False
        """A boot-up was heard since the last call of `take_boot`."""
        self.is_configuration_equal: bool | None = None
        """None: not known yet."""
        self.ask_due_ns = 0
        self._start_due_ns = 0

    def on_heartbeat(self, state: HeartbeatState) -> None:
        """A heartbeat or boot-up; after a boot-up the configuration is asked again.

        A boot-up may be lost: a node found in PRE-OPERATIONAL again has been elsewhere since.
        """
        if state is HeartbeatState.BOOT_UP:
            self.has_booted = True
            self.ask_due_ns = 0
        is_started_anew = state is HeartbeatState.PRE_OPERATIONAL and self.is_operational
        if state is HeartbeatState.BOOT_UP or is_started_anew:
            self.is_configuration_equal = None
        self.nmt = state

    def take_boot(self) -> bool:
        """Whether the node has booted since the last call."""
        has_booted, self.has_booted = self.has_booted, False
        return has_booted

    @property
    def is_operational(self) -> bool:
        """By its last heartbeat."""
        return self.nmt is HeartbeatState.OPERATIONAL

    def start_frame(self, now_ns: int) -> Frame | None:
        """The NMT start it needs, if it needs one now."""
        if self.nmt is None or self.is_operational or now_ns < self._start_due_ns:
            return None
        self._start_due_ns = now_ns + START_INTERVAL_NS
        return nmt_frame(NmtCommand.START, self.node_id)


class Nodes:
    """All other nodes, and the SDO client that asks for their configuration.

    Attributes, as of the last `take`:
        alive: whether all of a node's protected frames are within their time-outs.
        states: state of each actuator node, by its newest driver frame.
        is_driver_active: a driver uses some control.
        present_codes: codes whose cause some actuator node sees now.
        reported_codes: codes that some actuator node reports, latched or present.
    """

    def __init__(self, endpoint: Endpoint, hashes: dict[int, int]) -> None:
        self._endpoint = endpoint
        self._hashes = hashes
        self._reader = SdoClient()
        self.watches = {name: NodeWatch(name) for name in OTHERS}
        self._signs_of_life = {
            name: [endpoint.subscription(frame) for frame in frames]
            for name, frames in LIVENESS.items()
        }
        self.alive = dict.fromkeys(OTHERS, False)
        self.states: dict[str, NodeState] = {}
        self.is_driver_active = False
        self.present_codes = self.reported_codes = NO_CODES
        self._watch_of_heartbeat = {
            0x700 + watch.node_id: watch for watch in self.watches.values()
        }

    @property
    def acceptance(self) -> frozenset[int]:
        """SDO answers of all nodes."""
        return frozenset(0x580 + watch.node_id for watch in self.watches.values())

    def take(self, now_ns: int, messages: Sequence[Message]) -> None:
        """Takes this step's messages in and judges every node anew."""
        endpoint, watches = self._endpoint, self._watch_of_heartbeat
        for message in messages:
            watch = watches.get(message.can_id)
            if watch is not None:
                watch.on_heartbeat(message.content.state)
        self.alive = {
            name: False not in [sign.is_fresh(now_ns) for sign in signs]
            for name, signs in self._signs_of_life.items()
        }
        self.states = {}
        self.is_driver_active = False
        self.present_codes = self.reported_codes = NO_CODES
        for name, frame in DRIVER_FRAMES.items():
            newest = endpoint.newest(frame)
            if newest is not None:
                self._take_driver(name, newest.content)

    def _take_driver(self, name: str, content: DriverMessage) -> None:
        self.states[name] = content.node_state
        self.is_driver_active |= content.driver_active
        if content.present_codes:
            self.present_codes |= codes_of_bits(content.present_codes)
        flags = (
            content.er0, content.er1, content.er2, content.er3, content.er4, content.er5,
            content.er6,
        )
        if True in flags:
            self.reported_codes |= codes_of_flags(flags)

    def check_configuration(
        self, now_ns: int, received: Sequence[ReceivedFrame]
    ) -> list[Frame]:
        """Reads the hash of DBC and vehicle file of every node that is there and not yet known."""
        unknown = [
            watch
            for watch in self.watches.values()
            if watch.nmt is not None and watch.is_configuration_equal is None
        ]
        if not unknown and not self._reader.busy:
            return []
        ids = self.acceptance
        answers = [item.frame for item in received if item.frame.can_id in ids]
        frames = self._reader.step(now_ns, answers)
        for watch in unknown:
            self._judge_configuration(now_ns, watch)
        return frames

    def _judge_configuration(self, now_ns: int, watch: NodeWatch) -> None:
        results = self._reader.results
        keys = {(watch.node_id, CONFIGURATION, sub): sub for sub in self._hashes}
        missing = [key for key in keys if not isinstance(results.get(key), int)]
        if missing and now_ns >= watch.ask_due_ns:  # not asked yet, timed out, or refused
            watch.ask_due_ns = now_ns + ASK_INTERVAL_NS
            for key in missing:
                self._reader.request(*key)
        if not missing:
            watch.is_configuration_equal = all(
                results.pop(key) == self._hashes[sub] for key, sub in keys.items()
            )

    def is_heard(self, name: str, now_ns: int) -> bool:
        """Whether the node's heartbeat is within its time-out."""
        return self._endpoint.is_fresh(HEARTBEATS[name], now_ns)

    def newest_loss_ns(self, name: str, now_ns: int) -> int:
        """When the oldest of the node's protected frames was last heard."""
        ages = [self._endpoint.age_ns(message, now_ns) or 0 for message in LIVENESS[name]]
        return now_ns - max(ages)


@cache
def codes_of_bits(bits: int) -> frozenset[ErrorCode]:
    """Codes of a bit field in which bit n stands for ERn."""
    return frozenset(ErrorCode(n) for n in range(ER_CODES) if bits >> n & 1)


@cache
def codes_of_flags(flags: tuple[bool, ...]) -> frozenset[ErrorCode]:
    """Codes of the signals er0 to er6."""
    return frozenset(ErrorCode(n) for n, is_set in enumerate(flags) if is_set)
