"""The recorder of `bench.record`, in a process of its own.

    python -m bench.record_live PORT SECONDS RESULT.json [LOG]

Without LOG it only listens.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from pathlib import Path

from bench.monitor import WARM_UP_S
from bench.monitor_live import CHANNEL, udp_opener
from canbus.heard import Heard
from canbus.listener import SocketcanListener
from dbw.record import Recording, record_from, setting_of
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns
from telemetry.monitor.filters import Source
from telemetry.monitor.selection import Selection
from telemetry.record.formats import format_of
from telemetry.record.recorder import Recorder, Rotation


class NoRecorder:
    """Counts frames, as a recorder that costs nothing."""

    def __init__(self) -> None:
        self.frames = 0

    def add(self, frames: list[Heard], now_ns: int) -> None:
        """Counts."""
        self.frames += len(frames)

    def close(self, now_ns: int) -> None:
        """Nothing."""


def recorder_of(path: Path) -> Recorder:
    """As the command makes it."""
    kind = format_of(path, is_live=True)
    return Recorder(path, kind, setting_of(kind, (), relaxed=False), Rotation(), monotonic_ns())


def main() -> None:
    """Records for a while and writes what it cost."""
    port, seconds, result = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    recorder: Recording = recorder_of(Path(sys.argv[4])) if len(sys.argv) > 4 else NoRecorder()
    selection = Selection(sources=(Source.parse(CHANNEL),))
    gc.freeze()
    with SocketcanListener(
        [CHANNEL], realtime=realtime_ns, open_socket=udp_opener(port)
    ) as listener:
        end_ns = monotonic_ns() + WARM_UP_S * NS_PER_S
        while monotonic_ns() < end_ns:
            recorder.add(listener.hear(NS_PER_S // 10), monotonic_ns())
        lost, frames = listener.lost, recorder.frames
        start_ns, cpu_s = monotonic_ns(), time.process_time()
        record_from(listener, recorder, selection, seconds, lambda: False)
        cpu_s = time.process_time() - cpu_s
        wall_s = (monotonic_ns() - start_ns) / NS_PER_S
        answer = {
            "seconds": wall_s,
            "cpu": cpu_s / wall_s,
            "frames": recorder.frames - frames,
            "lost": listener.lost - lost,
        }
    result.write_text(json.dumps(answer), encoding="utf-8")


if __name__ == "__main__":
    main()
