"""Reasons as sentences a person can act on. Total: a test asks for every member of each table."""

from __future__ import annotations

from dbc.messages import Inhibit, MonitorReason, Reason
from dbc.spec import snake_case

NODE_TEXT = {
    "Supervisor": "the supervisor",
    "Steering": "the steering ECU",
    "Throttle": "the throttle ECU",
    "BrakeServo": "the brake-servo ECU",
    "SafetyMonitor": "the safety monitor",
    "Gateway": "the gateway",
}
"""By the DBC's names."""

_NODES = {
    snake_case(name).upper(): text
    for name, text in NODE_TEXT.items()
    if name != "Supervisor"
}
"""By the endings of `Inhibit`."""

INHIBIT_TEXT: dict[Inhibit, str] = {
    Inhibit.NONE: "nothing stands against engaging: call engage()",
    Inhibit.STARTING: "the supervisor is starting: wait a moment",
    Inhibit.PRESS_BUTTON: "press the Auto/Manual button",
    Inhibit.DRIVER_INPUT: "the driver is using pedals or steering wheel: let go of them",
    Inhibit.NOT_REQUESTED: "ready: call engage()",
    Inhibit.CODE_LATCHED: "an error code is latched: remove its cause, then call reset()",
    Inhibit.VERDICT_DENY: "the safety monitor denies",
    Inhibit.VERDICT_MISSING: "the safety monitor's verdict is missing: is it running?",
    **{
        Inhibit[f"CONFIGURATION_{node}"]: (
            f"{name} runs with another DBC or vehicle file than the supervisor:"
            " start both from the same files"
        )
        for node, name in _NODES.items()
    },
    **{
        Inhibit[f"MISSING_{node}"]: f"{name} is not heard: is it running and on this bus?"
        for node, name in _NODES.items()
    },
    **{
        Inhibit[f"NOT_OPERATIONAL_{node}"]: (
            f"{name} is not operational (NMT): wait for its start, or restart it"
        )
        for node, name in _NODES.items()
    },
    Inhibit.PLANNER_PERIOD: (
        "the planner's period is too long for the vehicle's command time-out: promise a shorter one"
    ),
    Inhibit.TOO_FAST: "the car is too fast to engage: slow down",
    Inhibit.FOREIGN_FRAME: "a frame of an unknown sender is on the bus: find it and unplug it",
    Inhibit.EMERGENCY_STOP_PRESSED: "the emergency stop is pressed: release it",
    Inhibit.NODE_UNRELEASED: "an ECU is still in its safe state: wait for it, or call reset()",
    Inhibit.MOVING: "the car is moving: bring it to a standstill first",
    Inhibit.NODE_UNHEALTHY: "an ECU reports a fault: see node_health, remove the cause",
}

ONLY_THE_BUTTON = INHIBIT_TEXT[Inhibit.PRESS_BUTTON]
"""What the state says in MANUAL when everything else is well."""

MONITOR_TEXT: dict[MonitorReason, str] = {
    MonitorReason.NONE: "no reason given",
    MonitorReason.STARTING: "it has not seen everything healthy yet",
    MonitorReason.FRAME_MISSING: "a frame is missing",
    MonitorReason.FRAME_LATE: "a frame is late",
    MonitorReason.UNKNOWN_IDENTIFIER: "an identifier is not known: find its sender and unplug it",
    MonitorReason.RATE_TOO_HIGH: "a frame comes more often than the DBC allows",
    MonitorReason.BAD_FRAME: "a frame has a wrong length, kind, counter or CRC",
    MonitorReason.SPEED: "the speed is above the envelope",
    MonitorReason.STEERING_ANGLE: "the steering-wheel angle is outside the envelope",
    MonitorReason.STEERING_RATE: "the steering wheel turns faster than the envelope allows",
    MonitorReason.LATERAL_ACCELERATION: (
        "the lateral acceleration is above the envelope: slow down in turns"
    ),
    MonitorReason.LATERAL_JERK: "the lateral jerk is above the envelope: steer more smoothly",
    MonitorReason.STEERING_DIVERGENCE: "the steering wheel does not follow its setpoint",
    MonitorReason.SPEED_DIVERGENCE: "the speed does not follow its setpoint",
    MonitorReason.BRAKE_DIVERGENCE: "the brake servo does not follow its setpoint",
    MonitorReason.COMMAND_STALE: "the planner's decision is too old: call command() every period",
    MonitorReason.MODE_RULE: "the supervisor changed the mode against the rules",
    MonitorReason.EMERGENCY_STOP: "an emergency stop is wanted by a node or the stop line",
    MonitorReason.FOREIGN_SENDER: "a frame comes from a node that does not own its identifier",
    MonitorReason.AUTHORISATION_RULE: "an actuator moves without authorisation",
    MonitorReason.LATE: "the monitor itself runs late: the computer is overloaded",
    MonitorReason.VALUE_NOT_AVAILABLE: "a node has no value from its sensor",
    MonitorReason.ERROR_REPORTED: "a node reports an error code",
}

REASON_TEXT: dict[Reason, str] = {
    Reason.NONE: "no reason given",
    Reason.EMERGENCY_STOP_INPUT: "the emergency stop was pressed",
    Reason.FAILSAFE_FRAME: "a global fail-safe command came over the bus",
    Reason.NODE_EMERGENCY: "another node wanted an emergency brake",
    Reason.VERDICT_BRAKE: "the safety monitor wanted an emergency brake",
    Reason.VERDICT_MISSING: "the safety monitor's verdict was missing",
    Reason.PLANNER_SILENT: "the planner's decision grew too old",
    Reason.COMMAND_MISSING: "the gateway's commands were missing",
    Reason.SUPERVISOR_SILENT: "the supervisor was not heard",
    Reason.NODE_SILENT: "a node was not heard",
    Reason.LATE: "a node ran late",
    Reason.OVERRUNS: "a node overran its cycle three times in a row",
    Reason.MOTOR_FAULT: "the steering motor's driver reported a fault",
    Reason.SENSOR_OUT_OF_BOUNDS: "a sensor was out of bounds",
    Reason.SERVO_ON_TOO_LONG: "the brake servo was on for too long",
    Reason.SERVO_STUCK: "the brake servo did not follow",
    Reason.FOREIGN_SENDER: "somebody else sent with a node's identifier",
    Reason.NMT_COMMAND: "a node was stopped or reset over the bus (NMT)",
    Reason.BUS_OFF: "a node's bus controller went bus-off",
    Reason.DRIVER_AGAINST_SYSTEM: "the driver acted against the system",
    Reason.REQUESTED: "the planner asked for it",
    Reason.BAD_FRAME: "a bad frame was received",
    Reason.ADOPTED: "a restarted node found the emergency already in force",
    Reason.BRAKING_IN_PROGRESS: "an emergency brake was already in progress",
}

assert set(INHIBIT_TEXT) == set(Inhibit)
assert set(MONITOR_TEXT) == set(MonitorReason)
assert set(REASON_TEXT) == set(Reason)
