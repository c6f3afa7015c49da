"""How the nodes are, which mode the car is in and which codes it has, from the rows of a bus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from canbus.node import NODE_IDS
from telemetry.monitor.known import SignalValue
from telemetry.monitor.model import BusModel, Presence, Row

UNKNOWN: Final = "?"
NONE: Final = "NONE"


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeHealth:
    """One node.

    Attributes:
        name: Of the DBC.
        missing: Names of its messages that are missing.
        late: Names of its messages that are late.
        expected: How many of its messages have a cycle.
        nmt: State in its newest heartbeat; UNKNOWN without one.
        state: Its own state; empty for a node that tells none.
        codes: Codes it reports.
    """

    name: str
    missing: tuple[str, ...]
    late: tuple[str, ...]
    expected: int
    nmt: str = ""
    state: str = ""
    codes: tuple[str, ...] = ()

    @property
    def presence(self) -> Presence:
        """MISSING if all that it sends is missing, LATE if some of it is late or missing."""
        if self.expected and len(self.missing) == self.expected:
            return Presence.MISSING
        return Presence.LATE if self.missing or self.late else Presence.ALIVE


@dataclass(frozen=True, slots=True, kw_only=True)
class CarHealth:
    """The car; UNKNOWN for what is not heard."""

    mode: str
    inhibit: str
    verdict: str
    verdict_reason: str
    codes: tuple[str, ...]


def node_health(model: BusModel, now_ns: int) -> list[NodeHealth]:
    """All nodes that send messages with a cycle, in the order of the DBC."""
    by_node: dict[str, list[Row]] = {}
    for row in model.rows.values():
        if row.known is not None and row.known.sender and row.missing_after_ns:
            by_node.setdefault(row.known.sender, []).append(row)
    order = {name: number for number, name in enumerate(NODE_IDS)}
    return [
        _node(name, by_node[name], now_ns)
        for name in sorted(by_node, key=lambda name: (order.get(name, len(order)), name))
    ]


def _node(name: str, rows: list[Row], now_ns: int) -> NodeHealth:
    names: dict[Presence, list[str]] = {presence: [] for presence in Presence}
    nmt = state = ""
    codes: tuple[str, ...] = ()
    for row in rows:
        presence = row.presence(now_ns)
        names[presence].append(row.name)
        if row.known is None or not row.known.is_own:
            continue
        values = {} if presence is Presence.MISSING else row_values(row)
        if row.name.endswith("_HEARTBEAT"):
            nmt = str(values["state"].value) if values else UNKNOWN
        elif "node_state" in row.known.signals:
            state = str(values["node_state"].value) if values else UNKNOWN
            codes = latched(values)
    return NodeHealth(
        name=name,
        missing=tuple(names[Presence.MISSING]),
        late=tuple(names[Presence.LATE]),
        expected=len(rows),
        nmt=nmt,
        state=state,
        codes=codes,
    )


def car_health(model: BusModel, now_ns: int) -> CarHealth | None:
    """Mode, verdict and codes; None for a bus that is not this project's."""
    if not model.interpreter.catalogue.has_own:
        return None
    state = _fresh(model, "SUPERVISOR_STATE", now_ns)
    verdict = _fresh(model, "SAFETY_VERDICT", now_ns)
    return CarHealth(
        mode=_text(state, "mode"),
        inhibit=_text(state, "inhibit"),
        verdict=_text(verdict, "verdict"),
        verdict_reason=_text(verdict, "reason"),
        codes=latched(state),
    )


def row_values(row: Row) -> dict[str, SignalValue]:
    """Signals of a row's newest frame by name; none if it cannot be believed."""
    if row.known is None or row.heard is None or row.heard.is_remote:
        return {}
    return {value.name: value for value in row.known.read(row.heard.data).values}


def latched(values: dict[str, SignalValue]) -> tuple[str, ...]:
    """Codes that signals named er0 to er6 report."""
    return tuple(
        name.upper() for name, value in values.items()
        if name.startswith("er") and name[2:].isdecimal() and value.number
    )  # fmt: skip


def _fresh(model: BusModel, name: str, now_ns: int) -> dict[str, SignalValue]:
    row = model.row_of(name)
    if row is None or row.presence(now_ns) is Presence.MISSING:
        return {}
    return row_values(row)


def _text(values: dict[str, SignalValue], name: str) -> str:
    return values[name].text() if name in values else UNKNOWN
