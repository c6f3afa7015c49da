"""Commands: only what is intact and young moves an actuator; and where the car then goes."""

from __future__ import annotations

from collections import deque
from math import isnan, nan
from typing import Final

from oracle.deadlines import Held
from oracle.decode import Message
from oracle.driver import ECHOES
from oracle.property import Complain, Once, Property, ms
from oracle.sample import Sample
from oracle.scene import Scene
from oracle.settings import Settings
from oracle.words import NEVER_NS, NS_PER_MS, NS_PER_S, Mode

SETPOINTS: Final = {
    "STEER_COMMAND": ("STEER_STATUS", "steering_wheel_angle_rad", 0.002),
    "THROTTLE_COMMAND": ("THROTTLE_STATUS", "wheel_speed_radps", 0.03),
    "BRAKE_COMMAND": ("BRAKE_STATUS", "position_ratio", 0.005),
}
"""Command, the status that echoes it, its signal, and what rounding may add."""
FULL_RATIO: Final = 0.99
"""A brake node in its safe state sends the servo here at once, whatever is commanded."""
AGE_MARGIN_NS: Final = 17 * NS_PER_MS
"""docs/safety.md: ER5 at the limit; design, time budget: and 15 ms, and the wire."""
DISTURBED_NS: Final = 50 * NS_PER_MS
"""A node that is late, or has lost a frame, may need this much more."""


class Axis:
    """One actuator's commands of late, and the setpoint that it applies."""

    __slots__ = ("applied", "bad", "intact", "newest", "signal", "slack", "status")

    def __init__(self, status: str, signal: str, slack: float) -> None:
        self.status = status
        self.signal = signal
        self.slack = slack
        self.applied: float | None = None
        self.newest: float | None = None
        self.intact: deque[tuple[int, float]] = deque()
        self.bad = ""


class OnlyIntactCommandsApplied(Property):
    """The setpoint that a status frame echoes follows commands that pass their protection alone.

    docs/safety.md, ER0: a frame with wrong length, kind, counter, CRC is ignored. While AUTOMATIC
    the echo moves between where it was and the intact setpoints of the last moment (the steering's
    reference cannot turn at once), towards zero speed, or at once to the full brake.
    """

    name = "only intact commands are applied"
    watches = (*SETPOINTS, *ECHOES)

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._window_ns = round(settings.steering_window_s * NS_PER_S)
        axes = {command: Axis(*row) for command, row in SETPOINTS.items()}
        self._of_command = axes
        self._of_status = {axis.status: axis for axis in axes.values()}

    def on_message(self, now_ns: int, message: Message) -> None:
        """A command, or the echo of one."""
        axis = self._of_command.get(message.name)
        if axis is not None:
            self._on_command(now_ns, axis, message)
        elif message.is_genuine and message.values:
            self._on_status(now_ns, self._of_status[message.name], message)

    def _on_command(self, now_ns: int, axis: Axis, message: Message) -> None:
        if not message.is_usable:
            told = message.values.get(axis.signal, "")
            axis.bad = f"; {message.fault} was wrong {now_ns / 1e9:.3f} s {told}"
            return
        setpoint = message.values[axis.signal]
        if isnan(setpoint):
            return
        axis.newest = setpoint
        axis.intact.append((now_ns, setpoint))
        self._forget(now_ns, axis)

    def _forget(self, now_ns: int, axis: Axis) -> None:
        """A setpoint that was replaced may still be on its way for a moment, no longer."""
        while len(axis.intact) > 1 and now_ns - axis.intact[1][0] > self._window_ns:
            axis.intact.popleft()

    def _on_status(self, now_ns: int, axis: Axis, message: Message) -> None:
        applied = message.values[ECHOES[axis.status]]
        before = axis.applied
        axis.applied = None if isnan(applied) else applied
        scene = self.scene
        if before is None or axis.applied is None or before == applied:
            return
        if scene.mode is not Mode.AUTOMATIC or scene.braking_since_ns is not None:
            return
        newest = before if axis.newest is None else axis.newest
        slack = axis.slack
        if min(before, newest) - slack <= applied <= max(before, newest) + slack:
            return
        if axis.status == "BRAKE_STATUS" and applied >= FULL_RATIO:
            return
        self._forget(now_ns, axis)
        known = [setpoint for _, setpoint in axis.intact] + [before]
        if axis.status != "STEER_STATUS":
            known.append(0.0)
        if not min(known) - slack <= applied <= max(known) + slack:
            self.violated(
                now_ns,
                f"{axis.status} applies {applied:g} after {before:g}, "
                f"commanded {min(known):g} to {max(known):g}{axis.bad}",
            )


class NoOldDecision(Property):
    """No decision of the planner older than the limit in force is obeyed: somebody brakes.

    docs/safety.md: the planner's last decision grows old, ER5 at the age limit. The age is what
    the command told and the time since; the limit is the supervisor's word, which counts from the
    beginning of a drive too.
    """

    name = "no old decision is obeyed"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._commands = [scene.channels[name] for name in SETPOINTS]
        self._held = Held(settings.sample_ns)
        self._once = Once()

    def _decided_ns(self) -> int:
        """When the oldest decision was made that a usable command carries."""
        oldest_ns = None
        for channel in self._commands:
            age_ms = nan if channel.newest is None else channel.newest.values["decision_age_ms"]
            if isnan(age_ms):
                return NEVER_NS
            decided_ns = channel.newest_ns - round(age_ms * NS_PER_MS)
            oldest_ns = decided_ns if oldest_ns is None else min(oldest_ns, decided_ns)
        return NEVER_NS if oldest_ns is None else oldest_ns

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Compares the oldest of the three with the limit."""
        scene = self.scene
        if scene.mode is not Mode.AUTOMATIC or scene.braking_since_ns is not None:
            self._held.update(now_ns, False)
            self._once.begins(False)
            return
        decided_ns = max(self._decided_ns(), scene.mode_since_ns)
        late_ns = now_ns - decided_ns - scene.decision_limit_ns
        # a command may come with its age: the nodes learn it in their next step
        is_known = self._held.update(now_ns, late_ns > 0)
        if late_ns <= AGE_MARGIN_NS or sample.is_full_brake_asked:
            self._once.begins(False)
            return
        margin_ns = AGE_MARGIN_NS + (DISTURBED_NS if scene.is_disturbed(now_ns) else 0)
        if self._once.begins(is_known and late_ns > margin_ns):
            self.violated(
                now_ns,
                f"obeyed at an age of {ms(now_ns - decided_ns)}, "
                f"limit {ms(scene.decision_limit_ns)}",
            )


class PathBounded(Property):
    """The engaged car stays near its path (UAH Section 5.3: 0.863 m at most)."""

    name = "path error bounded"

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._once = Once()

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Looks at the distance; NaN is no path."""
        is_far = (
            abs(sample.path_error_m) > self.settings.path_error_m_max
            and self.scene.mode is Mode.AUTOMATIC
        )
        if self._once.begins(is_far):
            self.violated(now_ns, f"{abs(sample.path_error_m):.2f} m from the path")
