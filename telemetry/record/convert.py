"""A log of any format into one of another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from telemetry.logs.reading import Log
from telemetry.record.formats import Format, Losses, Setting
from telemetry.record.log_file import LogFile
from telemetry.record.recorder import RecordingError


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """What became of a log.

    Attributes:
        frames: Written.
        problems: What could not be read; one line each.
        losses: What the new format cannot hold; one line each.
    """

    frames: int
    problems: Sequence[str]
    losses: Sequence[str]


def convert_log(path: Path, out: Path, kind: Format, setting: Setting) -> Conversion:
    """Writes the frames of a log into a new file; without a frame there is none.

    Raises:
        LogError: The log cannot be read at all.
        RecordingError: The new file exists or cannot be written; there is none then.
    """
    log = Log(path)
    losses = Losses(kind)
    frames = 0
    try:
        file = LogFile(out)
    except FileExistsError as error:
        raise RecordingError(f"{out} exists: name another file") from error
    except OSError as error:
        raise RecordingError(f"{out} cannot be written: {error.strerror}") from error
    is_whole = False
    try:
        writer = kind.open(file, setting)
        for chunk in log.chunks():
            heard = [frame.heard() for frame in chunk.frames()]
            losses.count(heard)
            writer.write(heard)
            frames += len(heard)
        writer.close()
        is_whole = frames > 0
    except OSError as error:
        raise RecordingError(f"{out} cannot be written: {error.strerror}") from error
    finally:
        if not is_whole:
            if not file.closed:
                file.cut(0)
                file.close()
            out.unlink(missing_ok=True)
    return Conversion(
        frames=frames, problems=log.problems.lines(), losses=losses.lines(setting.numbers)
    )
