"""What a live `dbw why` does with frames: tells incidents, stores freeze frames."""

from __future__ import annotations

import json
from collections.abc import Iterable

import click

from canbus.frame import ReceivedFrame
from dbw.failures import complain
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns
from telemetry.why.document import incident_json
from telemetry.why.freeze import FreezeError, FreezeStore
from telemetry.why.incident import Incident
from telemetry.why.watch import CodeOnset, ModeChange, Told, Watch
from telemetry.why.words import lines_of
from vehicles import Vehicle


class LiveWatch:
    """One bus; times count from its beginning.

    Args:
        vehicle: What the nodes believe about the car.
        store: Gets a freeze frame of each code; None: nothing is stored.
        channel: Of the bus, for the freeze frames.
        as_json: One object a line, in place of words.
    """

    def __init__(
        self, vehicle: Vehicle, store: FreezeStore | None, channel: str, *, as_json: bool
    ) -> None:
        self._watch = Watch(vehicle)
        self._store = store
        self._channel = channel
        self._as_json = as_json
        self._origin_ns = monotonic_ns()
        self._incidents = 0

    def take(self, received: Iterable[ReceivedFrame], now_ns: int) -> None:
        """Frames since the last call, none if the bus is silent."""
        for item in received:
            self._tell(self._watch.take(item.arrival_ns, item.frame))
        self._tell(self._watch.elapse(now_ns))

    def finish(self) -> None:
        """Tells what is not complete yet."""
        self._tell(self._watch.finish())

    def _clock(self, time_ns: int) -> str:
        return f"{(time_ns - self._origin_ns) / NS_PER_S:.3f} s"

    def _tell(self, told: Iterable[Told]) -> None:
        for item in told:
            if isinstance(item, CodeOnset):
                self._keep(item)
            elif isinstance(item, Incident):
                self._tell_incident(item)
            elif not self._as_json:
                self._tell_mode(item)

    def _tell_mode(self, change: ModeChange) -> None:
        before = "" if change.before is None else f"{change.before.name} -> "
        click.echo(f"{self._clock(change.time_ns)}  {before}{change.after.name}")

    def _tell_incident(self, incident: Incident) -> None:
        self._incidents += 1
        if self._as_json:
            line = incident_json(incident, self._incidents, self._origin_ns, self._clock)
            click.echo(json.dumps({"type": "incident", **line}))
            return
        for text in lines_of(incident, self._clock):
            click.echo(text)

    def _keep(self, onset: CodeOnset) -> None:
        """A freeze frame; one that cannot be written is complained of, and listening goes on."""
        if self._store is None:
            return
        unix_ns = realtime_ns() - (monotonic_ns() - onset.time_ns)
        try:
            stored = self._store.add(onset, unix_ns=unix_ns, channel=self._channel)
        except FreezeError as error:
            complain(error)
            return
        if self._as_json:
            line = {"type": "freeze_frame", "number": stored.number, "code": stored.code}
            click.echo(json.dumps(line))
        else:
            click.echo(
                f"{self._clock(onset.time_ns)}  {stored.code} from {onset.node}: freeze frame "
                f"{stored.number}"
            )
