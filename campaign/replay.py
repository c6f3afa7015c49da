"""One seed again, recorded: its frames, its picture, its faults and what followed."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from campaign.failure import run_or_tell, what_followed
from campaign.minimise import Minimal
from campaign.result import SeedResult
from campaign.settings import CampaignSettings
from canbus.frame import Frame
from dbc.endpoint import ID_OF_NAME
from simulation.fault_kinds import KINDS
from simulation.faults import Fault
from simulation.trace import candump_lines
from simulation.world import World
from telemetry.bus_log import BusLog
from telemetry.folder import ResultFolder
from telemetry.plots import plot_signals
from telemetry.signals import NamedSpan, Staged, read_signals

CHANNEL = "vcan0"
STATE_ID = ID_OF_NAME["SUPERVISOR_STATE"]
LOG, PICTURE, TEXT = "drive.log", "signals.png", "replay.txt"
FAULTS, FEWEST = "faults.toml", "fewest-faults.toml"


class RunSeedWatched(Protocol):
    """`campaign.run.run_seed`, or a stand-in."""

    def __call__(
        self,
        settings: CampaignSettings,
        seed: int,
        *,
        faults: Sequence[Fault] | None = None,
        watch: Callable[[World], None] | None = None,
    ) -> SeedResult:
        """Runs one seed."""


class Recorder:
    """Attached to a world, which goes on as if nobody looked.

    Attributes:
        log: Every frame.
    """

    def __init__(self) -> None:
        self.log = BusLog()
        self._world: World | None = None
        self._time_s = array("d")
        self._speed_mps = array("d")

    def watch(self, world: World) -> None:
        """Attaches it, at the world's beginning."""
        self._world = world
        world.wire.witnesses += [self.log, self._note_speed]

    def _note_speed(self, true_ns: int, sender: str, frame: Frame) -> None:
        if frame.can_id == STATE_ID and self._world is not None:
            self._time_s.append(true_ns / 1e9)
            self._speed_mps.append(self._world.car.truth.speed_mps)

    def staged(self, faults: Sequence[Fault]) -> Staged:
        """What the bus does not tell."""
        end_s = self.log.end_s
        return Staged(
            time_s=np.array(self._time_s),
            true_speed_mps=np.array(self._speed_mps),
            faults=tuple(_span(fault, end_s) for fault in faults if fault.at_s <= end_s),
        )


def _span(fault: Fault, end_s: float) -> NamedSpan:
    name = f"{fault.kind} of {fault.target}" if fault.target else str(fault.kind)
    for_s = 0.0 if KINDS[fault.kind].is_instant else fault.for_s
    return NamedSpan(name=name, start_s=fault.at_s, end_s=min(fault.at_s + for_s, end_s))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """A seed that was run once more.

    Attributes:
        result: This time's.
        stored: The campaign's; None if there is none of these settings and this code.
        faults: That were injected.
        recorder: What was recorded.
    """

    settings: CampaignSettings
    result: SeedResult
    stored: SeedResult | None
    faults: tuple[Fault, ...]
    recorder: Recorder

    @property
    def is_equal(self) -> bool:
        """Whether everything is as it was, down to the last frame."""
        return self.result == self.stored

    @property
    def comparison(self) -> str:
        """The same in words."""
        if self.stored is None:
            return "no stored result to compare with"
        if self.is_equal:
            return f"equal to the stored result, trace {self.result.trace_sha256[:16]}"
        if self.result.trace_sha256 == self.stored.trace_sha256:
            return f"differs from the stored result, with the same trace {self._short(self.result)}"
        traces = f"trace {self._short(self.result)}, stored {self._short(self.stored)}"
        return f"differs from the stored result: {traces}"

    @staticmethod
    def _short(result: SeedResult) -> str:
        return result.trace_sha256[:16] or "none"


def replay(
    run_seed: RunSeedWatched,
    settings: CampaignSettings,
    faults: Sequence[Fault],
    seed: int,
    stored: SeedResult | None,
) -> Replay:
    """Runs a seed with a recorder; an exception in it is part of what is recorded.

    Args:
        run_seed: Draws the faults itself, as it did in the campaign.
        settings, seed: Of the campaign.
        faults: The same faults, to be told and drawn.
        stored: The campaign's result.
    """
    recorder = Recorder()
    result = run_or_tell(partial(run_seed, watch=recorder.watch), settings, seed)
    return Replay(
        settings=settings, result=result, stored=stored, faults=tuple(faults), recorder=recorder
    )


def write_replay(folder: Path, again: Replay, fewest: Minimal[Fault] | None = None) -> list[Path]:
    """Writes drive.log (candump), signals.png, replay.txt, faults.toml and fewest-faults.toml.

    Args:
        folder: Gets all of the files or none.
        again: What was recorded.
        fewest: The faults that it takes, if they were looked for.

    Raises:
        FolderError: They cannot be written.
    """
    vehicle = again.settings.car
    log = again.recorder.log
    with ResultFolder(folder) as unfinished:
        path = unfinished.path
        with (path / LOG).open("w", encoding="ascii") as file:
            file.writelines(f"{line}\n" for line in candump_lines(log.rows(), CHANNEL))
        plot_signals(
            path / PICTURE,
            title=f"seed {again.result.seed}, {vehicle.name}, {len(again.faults)} faults",
            signals=read_signals(log, vehicle),
            staged=again.recorder.staged(again.faults),
        )
        (path / TEXT).write_text("\n".join(_lines(again, fewest)) + "\n", encoding="utf-8")
        for name, faults in ((FAULTS, again.faults), (FEWEST, fewest.items if fewest else ())):
            if faults:
                (path / name).write_text(fault_file(faults), encoding="utf-8")
        return unfinished.commit()


def _lines(again: Replay, fewest: Minimal[Fault] | None) -> Iterator[str]:
    result = again.result
    yield f"seed {result.seed}, {result.simulated_s:g} s: {again.comparison}"
    yield from ("", "broken properties" if result.violations else "no broken properties")
    for violation in result.violations:
        yield f"  at {violation.at_s:.3f} s: {violation.property}: {violation.text}"
    yield from ("", "faults, and what followed")
    followed = {(item.kind, item.target, item.at_s): item for item in result.injections}
    for fault in again.faults:
        item = followed.get((str(fault.kind), fault.target, fault.at_s))
        yield f"  {fault}"
        yield f"    {'it never came' if item is None else what_followed(item)}"
    if fewest is not None:
        kind = "fewest faults" if fewest.is_minimal else "fewer faults, the runs were used up"
        yield from ("", f"{kind} that still fail, after {fewest.runs} runs")
        yield from (f"  {fault}" for fault in fewest.items)


def fault_file(faults: Sequence[Fault]) -> str:
    """A file of faults (`simulation.faults`) that holds exactly these."""
    tables = []
    for fault in faults:
        lines = ["[[fault]]", f'kind = "{fault.kind}"']
        if fault.target:
            lines.append(f'target = "{fault.target}"')
        lines.append(f"at_s = {float(fault.at_s)!r}")
        if math.isfinite(fault.for_s):
            lines.append(f"for_s = {float(fault.for_s)!r}")
        lines.append(f"value = {float(fault.value)!r}")
        if fault.share != 1.0:
            lines.append(f"share = {float(fault.share)!r}")
        tables.append("\n".join(lines) + "\n")
    return "\n".join(tables)
