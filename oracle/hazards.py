"""Hazards: what must be answered by the emergency brake, and how that goes on."""

from __future__ import annotations

from typing import Final

from oracle.decode import Message
from oracle.hazard import Hazard
from oracle.property import Complain, Property, ms
from oracle.sample import Sample
from oracle.scene import Fault, Scene
from oracle.settings import Settings
from oracle.words import BRAKE_FRAMES, DRIVING, HUMAN, NS_PER_S, Mode, Request

STANDING_MPS: Final = 0.05
FULL_RATIO: Final = 0.9


class HazardAnswered(Property):
    """Every hazard of a car that drives itself is answered within its fault-tolerant time.

    The answer is EMERGENCY_BRAKE on the bus or the servo sent to its end. The injector tells each
    hazardous fault's time (100 ms by default); the emergency stop, FAILSAFE and the planner's own
    request are sensed causes of 20 ms (docs/safety.md; the time budget). A driver who has taken
    the car meanwhile, or a fault that went before its time, needs no answer; a further fault
    before the answer begins the time anew. A controlled stop needs no planner, nor its frames.
    """

    name = "hazard answered in time"
    watches = (*BRAKE_FRAMES, "SUPERVISOR_STATE", "MODE_REQUEST", "FAILSAFE")

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        super().__init__(scene, settings, complain)
        self._was_stop_pressed = False

    def on_fault(self, now_ns: int, fault: Fault, *, is_begin: bool) -> None:
        """A hazardous fault opens a hazard; one that ends unanswered in its time closes it."""
        if is_begin:
            self._postpone(now_ns)
        if is_begin and fault.budget_ns is not None:
            self._begin(
                now_ns, fault.kind, fault.target, fault.budget_ns, is_planners=fault.is_planners
            )
        if not is_begin:
            for hazard in self.scene.open_hazards:
                is_it = (hazard.kind, hazard.target) == (fault.kind, fault.target)
                hazard.is_over |= is_it and not hazard.is_answered
            self._forget()

    def _postpone(self, now_ns: int) -> None:
        """Another fault may strike who was about to answer: the time counts from the last."""
        for hazard in self.scene.open_hazards:
            if not hazard.is_answered and not hazard.is_late_told:
                again_ns = now_ns - hazard.began_ns + self.settings.hazard_ns
                hazard.budget_ns = max(hazard.budget_ns, again_ns)

    def _begin(
        self, now_ns: int, kind: str, target: str, budget_ns: int, *, is_planners: bool = False
    ) -> None:
        scene = self.scene
        if scene.mode not in DRIVING or scene.braking_since_ns is not None:
            return
        if is_planners and scene.mode is Mode.STOPPING:
            return
        speed_mps = abs(scene.sample.speed_mps)
        hazard = Hazard(kind, target, now_ns, budget_ns, speed_mps, is_planners)
        scene.hazards.append(hazard)
        scene.open_hazards.append(hazard)

    def _begin_sensed(self, now_ns: int, kind: str, target: str) -> None:
        is_disturbed = self.scene.is_disturbed(now_ns)
        settings = self.settings
        budget_ns = settings.hazard_ns if is_disturbed else settings.sensed_ns
        self._begin(now_ns, kind, target, budget_ns)

    def on_message(self, now_ns: int, message: Message) -> None:
        """The answer; or a cause that is a frame."""
        name = message.name
        if name == "SUPERVISOR_STATE":
            if self.scene.open_hazards and message.is_genuine and self.scene.mode in HUMAN:
                for hazard in self.scene.open_hazards:
                    hazard.is_over = True
                self._forget()
            elif self.scene.mode is Mode.STOPPING and message.is_genuine:
                for hazard in self.scene.open_hazards:
                    hazard.is_over |= hazard.is_planners and not hazard.is_answered
                self._forget()
            if self.scene.mode is not Mode.EMERGENCY or not message.is_genuine:
                return
        elif name == "FAILSAFE":
            if message.is_usable:
                self._begin_sensed(now_ns, name, message.sender)
            return
        elif name == "MODE_REQUEST":
            is_stop = message.values.get("request") == Request.EMERGENCY_STOP
            if is_stop and message.is_usable and not self.scene.open_hazards:
                self._begin_sensed(now_ns, "the planner's stop", message.sender)
            return
        if not message.values:
            return
        for hazard in self.scene.open_hazards:
            if hazard.emergency_ns is None:
                self._judge(now_ns, hazard)
                hazard.emergency_ns = now_ns

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """What the truth says of every open hazard."""
        if sample.emergency_stop_pressed and not self._was_stop_pressed:
            self._begin_sensed(now_ns, "emergency stop", "driver")
        self._was_stop_pressed = sample.emergency_stop_pressed
        if not self.scene.open_hazards:
            return
        for hazard in self.scene.open_hazards:
            if sample.is_full_brake_asked and hazard.setpoint_ns is None:
                self._judge(now_ns - self.settings.sample_ns, hazard)
                hazard.setpoint_ns = now_ns
            if hazard.full_ns is None and sample.servo_position_ratio >= FULL_RATIO:
                hazard.full_ns = now_ns
            if hazard.standstill_ns is None and abs(sample.speed_mps) < STANDING_MPS:
                hazard.standstill_ns = now_ns
            self._judge(now_ns, hazard)
        self._forget()

    def _judge(self, now_ns: int, hazard: Hazard) -> None:
        """Complains once if there is no answer yet and it is due."""
        late_ns = now_ns - hazard.began_ns - hazard.budget_ns
        if late_ns > 0 and not hazard.is_answered and not hazard.is_late_told:
            hazard.is_late_told = True
            hazard.is_excused = self.scene.excuse(now_ns, self.name) is not None
            self.violated(now_ns, f"{hazard}: no answer within {ms(hazard.budget_ns)}")

    def _forget(self) -> None:
        self.scene.open_hazards = [
            hazard
            for hazard in self.scene.open_hazards
            if not (hazard.is_over or (hazard.full_ns and hazard.standstill_ns))
        ]


class HazardEndsBraked(Property):
    """Every hazard ends with the brake at 90 % and a standing car, if the driver does not take it.

    90 % within the hazard's time and the servo's travel (UWA Testing: 0.29 s; design, time
    budget); a standstill within the time that the worst road of the vehicle file needs.
    """

    name = "hazard ends braked at a standstill"

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """Judges the hazards that are open."""
        for hazard in self.scene.open_hazards:
            if not hazard.is_end_told:
                self._judge(now_ns, sample, hazard)

    def _judge(self, now_ns: int, sample: Sample, hazard: Hazard) -> None:
        settings = self.settings
        waited_ns = now_ns - hazard.began_ns
        brake_ns = hazard.budget_ns + settings.servo_travel_ns + settings.sample_ns
        stop_ns = brake_ns + round(hazard.speed_mps / settings.deceleration_mps2_min * NS_PER_S)
        if hazard.full_ns is None and waited_ns > brake_ns:
            what = f"brake at {sample.servo_position_ratio:.2f}"
        elif hazard.standstill_ns is None and waited_ns > stop_ns:
            what = f"still {sample.speed_mps:.2f} m/s"
        else:
            return
        hazard.is_end_told = True
        self.violated(now_ns, f"{hazard}: {what} after {ms(waited_ns)}")
