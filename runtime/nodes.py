"""The nodes of a stack: what they are called, where they are, when in the cycle they step."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from canbus.node import NODE_IDS, PERIOD_NS, Node
from runtime.clock import NS_PER_MS
from runtime.errors import LaunchError
from runtime.harness import Wires
from vehicles import Vehicle

PLANT = "plant"
"""The simulated car: no node of the vehicle bus, but a thread or process like them."""

PLANT_PHASE_NS = 0
"""The plant reads its sensors first; each node then finds readings a few milliseconds old."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeEntry:
    """One row of the table.

    Attributes:
        name: as on the command line and as the package is called.
        node: the DBC's name.
        module: where its class is; imported only when the node is built, so that a process holds
            its own node alone.
        class_name: constructed with the vehicle.
        wires: class in `runtime.wires`.
        phase_ns: where its steps lie in the cycle, apart from each other so that nodes that share
            a processor do not all wake at once.
    """

    name: str
    node: str
    module: str
    class_name: str
    wires: str
    phase_ns: int


def _entry(
    name: str, node: str, module: str, class_name: str, wires: str, phase_ms: int
) -> NodeEntry:
    assert node in NODE_IDS and PLANT_PHASE_NS < phase_ms * NS_PER_MS < PERIOD_NS
    return NodeEntry(
        name=name,
        node=node,
        module=module,
        class_name=class_name,
        wires=wires,
        phase_ns=phase_ms * NS_PER_MS,
    )


NODES = {
    entry.name: entry
    for entry in (
        _entry("steering", "Steering", "ecus.steering.ecu", "SteeringEcu", "SteeringWires", 2),
        _entry("throttle", "Throttle", "ecus.throttle.ecu", "ThrottleEcu", "ThrottleWires", 3),
        _entry(
            "brake_servo", "BrakeServo", "ecus.brake_servo.ecu", "BrakeServoEcu", "BrakeWires", 4
        ),
        _entry(
            "supervisor", "Supervisor", "ecus.supervisor.ecu", "SupervisorEcu", "SupervisorWires", 5
        ),
        _entry(
            "safety_monitor",
            "SafetyMonitor",
            "safety_monitor.monitor",
            "SafetyMonitor",
            "MonitorWires",
            6,
        ),
    )
}
"""The nodes of the vehicle bus by name. The gateway is the planner's (`gateway.connect`)."""

STOP_ORDER = ("supervisor", "safety_monitor", "steering", "throttle", "brake_servo", PLANT)
"""The brake stays as long as anything can move, and its hardware longest."""

assert set(STOP_ORDER) == {*NODES, PLANT}


def node_entry(name: str) -> NodeEntry:
    """The row of a node.

    Raises:
        LaunchError: no node has this name.
    """
    entry = NODES.get(name)
    if entry is None:
        raise LaunchError(f"node {name!r} is not known: allowed {', '.join((*NODES, PLANT))}")
    return entry


def build_node(name: str, vehicle: Vehicle) -> Node[Any, Any]:
    """A node, its module imported now.

    Raises:
        LaunchError: no node has this name.
    """
    entry = node_entry(name)
    node: Node[Any, Any] = getattr(import_module(entry.module), entry.class_name)(vehicle)
    assert node.name == entry.node, f"{entry.module} calls itself {node.name}"
    return node


def build_wires(name: str) -> Wires[Any, Any]:
    """A node's share of the harness.

    Raises:
        LaunchError: no node has this name.
    """
    entry = node_entry(name)
    wires: Wires[Any, Any] = getattr(import_module("runtime.wires"), entry.wires)()
    return wires
