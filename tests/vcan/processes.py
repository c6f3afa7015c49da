"""What runs in the processes of nodes and car."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import fields
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from canbus.node import Event
from runtime.clock import monotonic_ns
from runtime.node_process import run_node_process
from runtime.plant_process import ACCEPTANCE, PlantSide, build_car, run_plant
from runtime.process_settings import ProcessSettings
from runtime.realtime import apply_realtime, keep_collections_short
from runtime.stopping import StopRequest
from simulation.plant.state import PlantFaults, Truth
from tests.vcan.namespaces import enter


def _say(event: Event) -> None:
    sys.stdout.write(f"{event.time_ns / 1e9:.4f} {event.node} {event.kind}: {event.text}\n")
    sys.stdout.flush()


def _redirect(log: Path) -> None:
    """This process's output goes to a file of its own, appended."""
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    sys.stdout = os.fdopen(1, "w", closefd=False)


def node_main(settings: ProcessSettings, log: Path) -> None:
    """A node's process, as `dbw ecu`."""
    _redirect(log)
    sys.exit(run_node_process(settings, _say).exit_code)


def plant_main(settings: ProcessSettings, log: Path, control: Connection) -> None:
    """The car's process; `(name, value)` on the pipe breaks something."""
    _redirect(log)
    vehicle = settings.load_vehicle()
    keep_collections_short()
    apply_realtime(settings.realtime)
    start_ns = monotonic_ns()
    car = build_car(vehicle, seed=1, start_ns=start_ns)
    plant = PlantSide(car, start_ns)
    whole = PlantFaults()

    def on_cycle(truth: Truth) -> None:
        while control.poll():
            name, value = control.recv()
            if name == "truth":
                control.send(truth)
            elif name == "repair":
                for field in fields(PlantFaults):
                    setattr(car.faults, field.name, getattr(whole, field.name))
            else:
                setattr(car.faults, name, value)

    with ExitStack() as opened:
        stop = opened.enter_context(StopRequest())
        bus = opened.enter_context(settings.harness_bus(vehicle, ACCEPTANCE))
        drives = plant.drive_acceptance
        vehicle_bus = settings.vehicle_bus(vehicle, drives) if drives else None
        if vehicle_bus is not None:
            opened.enter_context(vehicle_bus)
        keep_collections_short()
        run_plant(plant, bus, monotonic_ns, stop, _say, on_cycle, vehicle_bus=vehicle_bus)


def in_namespace(namespace: str | None, main: Callable[..., None], *arguments: Any) -> None:
    """The first thing that a process does."""
    if namespace is not None:
        enter(namespace)
    main(*arguments)
