"""A planner in a process of its own, told over a pipe: it must not fall silent while we look."""

from __future__ import annotations

import math
from multiprocessing.connection import Connection
from typing import NamedTuple

from dbc.messages import Mode
from gateway.connect import connect
from gateway.errors import EngageRefused, ResetRefused
from runtime.realtime import RealtimeSettings, apply_realtime, keep_collections_short
from runtime.stopping import StopRequest

PERIOD_S = 0.02
SPEED_MPS = 4.0
CURVATURE_PER_M, TURN_S = 0.03, 20.0
"""A gentle serpentine: bends of 33 m at the tightest."""

ENGAGE, RESET, LOOK = "engage", "reset", "look"


class View(NamedTuple):
    """What it answers."""

    mode: Mode | None
    why_not_engaged: str
    distance_m: float


def plan(channel: str, control: Connection) -> None:
    """Decides at 50 Hz from the moment it is told to engage; ends at SIGTERM."""
    apply_realtime(RealtimeSettings())  # as the nodes: the gateway is one, and lives in here
    keep_collections_short()
    ticks, distance_m, is_driving = 0, 0.0, False
    with StopRequest() as stop, connect("socketcan", channel, planner_period_s=PERIOD_S) as car:
        for state in car.ticks(PERIOD_S):
            if stop.is_set():
                return
            if control.poll():
                wish = control.recv()
                try:
                    if wish == ENGAGE:
                        car.engage()
                        is_driving = True
                    elif wish == RESET:
                        car.reset()
                except (EngageRefused, ResetRefused):
                    pass  # the view tells
                control.send(View(car.state.mode, car.state.why_not_engaged, distance_m))
            if is_driving:
                ticks += 1
                if not math.isnan(state.speed_mps):
                    distance_m += state.speed_mps * PERIOD_S
                turn_rad = 2 * math.pi * ticks * PERIOD_S / TURN_S
                car.command(
                    speed_mps=SPEED_MPS, curvature_per_m=CURVATURE_PER_M * math.sin(turn_rad)
                )
