"""A bus, a car and a clock for the dashboard's tests; nothing here waits for anything."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from canbus.heard import Heard
from dbc.messages import (
    BrakeDriver,
    BrakeStatus,
    Inhibit,
    Mode,
    MonitorReason,
    NodeState,
    SafetyVerdict,
    SteerDriver,
    SteerStatus,
    SupervisorState,
    ThrottleDriver,
    ThrottleStatus,
    Verdict,
)
from dbc.protection import COUNTER_MODULO
from telemetry.dashboard.access import Access
from telemetry.dashboard.control import Action, Limits, Refused, Wish
from telemetry.dashboard.hub import Client, Hub
from telemetry.dashboard.picture import HumanClock, Picture
from tests.telemetry.monitored import MS, S, heartbeat, own
from vehicles import load_vehicle

TOKEN = "a-token-for-tests-0815"
CYCLE_NS = 10 * MS
STEP_NS = 50 * MS
BITRATE_BPS = 500_000
LIMITS = Limits(speed_mps=6.0, curvature_per_m=0.1, pedal_ratio=1.0, steering_torque_nm=10.0)


@dataclass(slots=True)
class CarOnBus:
    """Sends what a car's nodes send, every 10 ms, as long as it is not silent."""

    mode: Mode = Mode.MANUAL
    inhibit: Inhibit = Inhibit.PRESS_BUTTON
    wheel_speed_radps: float = 0.0
    wheel_rad: float = 0.0
    has_er1: bool = False
    is_silent: bool = False
    _cycle: int = 0
    _due_ns: int | None = None

    def frames(self, now_ns: int) -> list[Heard]:
        """Everything since the last call."""
        if self._due_ns is None:
            self._due_ns = now_ns
        frames: list[Heard] = []
        while self._due_ns <= now_ns:
            if not self.is_silent:
                frames += self._of_cycle(self._due_ns)
            self._cycle += 1
            self._due_ns += CYCLE_NS
        return frames

    def _of_cycle(self, time_ns: int) -> list[Heard]:
        counter = self._cycle % COUNTER_MODULO
        is_on = self.mode is Mode.AUTOMATIC
        codes: dict[str, Any] = {f"er{n}": False for n in range(7)}
        messages: dict[str, Any] = {
            "SUPERVISOR_STATE": SupervisorState(
                mode=self.mode, steering_authorised=is_on, throttle_authorised=is_on,
                brake_authorised=is_on, **codes | {"er1": self.has_er1}, reset_epoch=0,
                decision_age_ms_max=85, inhibit=self.inhibit,
            ),
            "STEER_STATUS": SteerStatus(
                steering_wheel_angle_rad=self.wheel_rad,
                applied_steering_wheel_angle_rad=self.wheel_rad,
            ),
            "THROTTLE_STATUS": ThrottleStatus(
                wheel_speed_radps=self.wheel_speed_radps,
                applied_wheel_speed_radps=self.wheel_speed_radps,
            ),
            "BRAKE_STATUS": BrakeStatus(
                servo_position_ratio=0.0, applied_position_ratio=0.0,
                rear_wheel_speed_radps=self.wheel_speed_radps,
            ),
            "SAFETY_VERDICT": SafetyVerdict(
                verdict=Verdict.PERMIT, reason=MonitorReason.NONE, identifier=0, value=0
            ),
        }  # fmt: skip
        if self._cycle % 2 == 0:
            driver: dict[str, Any] = {
                "driver_active": False, "node_state": NodeState.RELEASED, "present_codes": 0,
                **codes,
            }  # fmt: skip
            messages["STEER_DRIVER"] = SteerDriver(torque_nm=0.5, **driver)
            messages["THROTTLE_DRIVER"] = ThrottleDriver(pedal_ratio=0.25, **driver)
            messages["BRAKE_DRIVER"] = BrakeDriver(pedal_ratio=0.0, **driver)
            counter_of_driver = self._cycle // 2 % COUNTER_MODULO
        frames = []
        for name, message in messages.items():
            number = counter_of_driver if name.endswith("_DRIVER") else counter
            frames.append(own(name, message, number, time_ns))
        if self._cycle % 5 == 0:
            frames += [
                heartbeat(f"{node}_HEARTBEAT", time_ns)
                for node in ("SUPERVISOR", "STEER", "THROTTLE", "BRAKE", "SAFETY_MONITOR")
            ]
        return frames


@dataclass(slots=True)
class FakeControls:
    """Notes what is asked for; refuses what it is told to refuse."""

    actions: frozenset[Action] = frozenset(Action)
    limits: Limits = LIMITS
    done: list[Action] = field(default_factory=list)
    wishes: list[Wish] = field(default_factory=list)
    refusal: str = ""

    def emergency_brake(self) -> None:
        """At once."""
        self.act(Action.EMERGENCY_BRAKE)

    def act(self, action: Action) -> None:
        """Any other action."""
        if self.refusal:
            raise Refused(self.refusal)
        self.done.append(action)

    def hold(self, wish: Wish) -> None:
        """The wish in force."""
        if self.refusal:
            raise Refused(self.refusal)
        self.wishes.append(wish)


def human_clock() -> HumanClock:
    """Times of day as seconds."""
    return HumanClock(unix_s=lambda ns: ns / S, text=lambda ns: f"{ns / S:.3f}")


def run_at_once(run: Callable[[], None], done: Callable[[str], None]) -> None:
    """In place of a thread."""
    try:
        run()
    except Refused as refusal:
        done(str(refusal))
    else:
        done("")


class Rig:
    """A hub on a car's bus, with browsers that keep what they are sent."""

    def __init__(self) -> None:
        self.car = CarOnBus()
        self.controls = FakeControls()
        self.picture = Picture(load_vehicle("tabby_evo"), "can0", BITRATE_BPS, human_clock())
        self.hub = Hub(
            self.picture, Access(TOKEN), self.controls, run_at_once, {"vehicle": "tabby_evo"}
        )
        self.now_ns = S

    def run(self, duration_s: float) -> None:
        """Lets time pass."""
        for _ in range(round(duration_s * S / STEP_NS)):
            self.now_ns += STEP_NS
            self.picture.feed(self.car.frames(self.now_ns), self.now_ns, 0)
            self.hub.step(self.now_ns)

    def browser(self, *, with_token: bool = False) -> Browser:
        """Connects one."""
        browser = Browser(self)
        assert self.hub.open(browser.client)
        if with_token:
            browser.say(do="show_token", token=TOKEN)
        return browser


class Browser:
    """One browser, as the hub sees it."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self.got: list[dict[str, Any]] = []
        self.is_busy = False
        self.is_closed = False
        self.client = Client(
            lambda text: self.got.append(json.loads(text)), lambda: self.is_busy, self._close
        )

    def _close(self) -> None:
        self.is_closed = True

    def say(self, **message: object) -> None:
        """Sends a message."""
        self._rig.hub.take(self.client, json.dumps(message), self._rig.now_ns)

    def shown(self) -> dict[str, Any]:
        """What its page shows by now."""
        values: dict[str, Any] = {}
        for message in self.got:
            news = dict(message.get("news", {}))
            for name in ("path", "log"):
                kept = [] if message.get("anew") else values.get(name, [])
                values[name] = kept + news.pop(name, [])
            values |= news
        return values

    @property
    def refusals(self) -> list[str]:
        """What it was told not to do."""
        return [message["refused"] for message in self.got if "refused" in message]
