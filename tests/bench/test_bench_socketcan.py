"""The measures on SocketCAN: how logs are judged and tables made; the machine is not needed."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from bench import socketcan
from bench.socketcan import SocketcanResult, measure_parts
from bench.socketcan.buslog import lost_frames, read_bus_log
from bench.socketcan.cost import Cost, CostResult
from bench.socketcan.echo import EchoResult
from bench.socketcan.flood import FloodResult
from bench.socketcan.guest import CALL, PARTS
from bench.socketcan.load import BITRATE_BPS, LOAD, LoadResult
from bench.socketcan.nodelog import Overruns, read_losses, read_overruns
from bench.socketcan.proc import cpu_ns, resident_mib
from bench.socketcan.traffic import STRANGER_BITS, STRANGERS, gap_ms
from canbus.frame import Frame
from canbus.timing import frame_bits
from dbc.endpoint import Endpoint
from dbc.messages import SPECS, SteerStatus
from tests.bench.test_bench_measures import assert_well_formed
from vehicles import load_vehicle

BEGIN_S = 1_800_000_000.0
STATUS_ID = 0x182


def status_lines(count: int) -> list[str]:
    """STEER_STATUS every 10 ms, as `candump -L` writes it."""
    steering = Endpoint("Steering", ())
    content = SPECS[STATUS_ID].unpack(0)
    assert isinstance(content, SteerStatus)
    return [
        f"({BEGIN_S + number / 100:.6f}) vcan0 {steering.frame('STEER_STATUS', content)} R\n"
        for number in range(count)
    ]


def test_a_whole_log_has_lost_nothing_and_its_length_is_exact() -> None:
    lines = status_lines(100)
    log = read_bus_log(lines, BEGIN_S, BEGIN_S + 1.0)
    stream = log.streams[STATUS_ID]
    assert (stream.name, stream.cycle_ms) == ("STEER_STATUS", 10.0)
    assert (stream.frames, stream.lost) == (100, 0)
    assert stream.periods_ms == pytest.approx((10.0, 10.0, 10.0), abs=0.002)
    assert log.frames == 100 and log.brakes == 0
    frames = [Frame(STATUS_ID, bytes.fromhex(line.split()[2][4:])) for line in lines]
    assert log.bits == sum(frame_bits(frame) for frame in frames)


def test_frames_outside_the_measured_time_do_not_count() -> None:
    log = read_bus_log(status_lines(100), BEGIN_S + 0.1, BEGIN_S + 0.2)
    assert log.frames == 10 and log.streams[STATUS_ID].lost == 0


def test_missing_frames_are_found_by_their_counters_and_by_the_gap() -> None:
    lines = status_lines(100)
    del lines[50:53], lines[20]
    stream = read_bus_log(lines, BEGIN_S, BEGIN_S + 1.0).streams[STATUS_ID]
    assert stream.lost == 4
    assert stream.periods_ms[2] == pytest.approx(40.0, abs=0.002)


def test_an_emergency_brake_and_what_has_no_counter_are_seen() -> None:
    lines = [f"({BEGIN_S:.6f}) vcan0 012#0000000000000000", f"({BEGIN_S:.6f}) vcan0 702#05"]
    log = read_bus_log(lines, BEGIN_S, BEGIN_S + 1.0)
    assert log.brakes == 1
    assert log.streams[0x702].lost is None and log.streams[0x702].periods_ms == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("counters", "lost"),
    [([], 0), ([3], 0), ([13, 14, 0, 1], 0), ([13, 0], 1), ([0, 14], 13), ([5, 5], 14)],
)
def test_alive_counters_run_from_0_to_14(counters: list[int], lost: int) -> None:
    assert lost_frames(counters) == lost


BEFORE = """\
Steering: overrun: overrun (41.8 ms)
Steering: overrun: 2 overruns and 5 skipped cycles so far, latest by 40.0 ms, at worst 48.5 ms
"""
DURING = """\
Steering: overrun: 3 overruns and 5 skipped cycles so far, latest by 6.5 ms, at worst 48.5 ms
Steering: frame: 2 frames not sent so far: the bus refused them
Supervisor: overrun: 1 overruns and 0 skipped cycles so far, latest by 3.5 ms, at worst 3.5 ms
Steering: overrun: 5 overruns and 6 skipped cycles so far, latest by 5.5 ms, at worst 48.5 ms
"""


def test_overruns_are_those_of_the_measured_time() -> None:
    assert read_overruns(BEFORE, DURING) == {
        "Steering": Overruns(count=3, skipped=1, late_ms_max=6.5),
        "Supervisor": Overruns(count=1, skipped=0, late_ms_max=3.5),
    }
    assert read_overruns(BEFORE, "") == {}


def test_losses_are_what_nodes_say_of_lost_frames() -> None:
    assert read_losses(DURING) == [DURING.splitlines()[1]]
    assert read_losses(BEFORE) == []


def test_strangers_keep_to_their_range_and_fill_the_bus_as_told() -> None:
    bus = load_vehicle("tabby_evo").bus
    assert all(bus.foreign_id_min <= frame.can_id <= bus.foreign_id_max for frame in STRANGERS)
    rate_per_s = len(STRANGERS) * 1e3 / gap_ms(LOAD, 100_000, BITRATE_BPS)
    assert rate_per_s * STRANGER_BITS + 100_000 == pytest.approx(LOAD * BITRATE_BPS)


def test_a_process_has_used_some_time_and_memory() -> None:
    assert cpu_ns(os.getpid()) > 0
    assert 1.0 < resident_mib(os.getpid()) < 10_000.0


def measured() -> dict[str, object]:
    """A result of each part."""
    log = read_bus_log(status_lines(100), BEGIN_S, BEGIN_S + 1.0)
    spans = {"python-can": 90_000, "bus": 66_000, "runtime": 81_000, "cycle": 72_000}
    return {
        "echo": tuple(
            EchoResult(name=name, spans_ns=(span_ns,) * 3) for name, span_ns in spans.items()
        ),
        "flood": tuple(
            FloodResult(name=name, frames=100, cpu_s=cpu_s)
            for name, cpu_s in (("candump", 0.001), ("ours", 0.002))
        ),
        "cost": CostResult(
            span_s=20.0, frames_per_s=900.0,
            costs=(Cost(name="steering", rest_ratio=0.07, drive_ratio=0.08, resident_mib=41.0),
                   Cost(name="car", rest_ratio=0.1, drive_ratio=0.1, resident_mib=None)),
        ),
        "load": LoadResult(
            span_s=1.0, log=log, strangers=3000, is_automatic=True, distance_m=4.0,
            overruns={"Steering": Overruns(count=5, skipped=0, late_ms_max=6.0)},
            losses=(), kernel_drops=0,
        ),
    }


def test_the_tables_tell_ratios_and_what_was_met() -> None:
    result = SocketcanResult(quick=True, is_emulated=True, measured=measured())
    tables = result.tables()
    assert_well_formed(tables)
    text = "\n".join(table.markdown() for table in tables)
    assert "| runtime | 81.0 | 81.0 | 0.90 | met |" in text
    assert "| ours | 20.00 | 50,000 | 0.500 |" in text
    assert "| steering | 7.0% | 700 | 8.0% | 800 | 41 |" in text
    assert "| frames of ours lost, by alive counters | 0 | met |" in text
    assert "| overruns; cycles skipped; latest cycle | 5; 0; 6.0 ms | counted |" in text
    assert text.count("dbw vm run --icount 0") == len(tables)


def test_results_come_back_from_where_socketcan_is(monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[list[str]] = []

    def machine(command: list[str]) -> tuple[int, bytes]:
        commands.append(command)
        return 0, pickle.dumps(measured())

    monkeypatch.setattr(socketcan, "NETWORKS", ("no such network",))
    monkeypatch.setattr(socketcan, "_in_the_machine", machine)
    result = socketcan.measure(quick=True)
    assert result.is_emulated and set(result.measured) == set(PARTS)
    assert commands[0][0] == sys.executable and commands[0][3:] == [*PARTS, "--quick"]


def test_a_part_that_fails_is_no_measure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socketcan, "_in_the_machine", lambda command: (1, b""))
    monkeypatch.setattr(socketcan, "NETWORKS", ("no such network",))
    with pytest.raises(RuntimeError, match="exit code 1"):
        measure_parts(("echo",), quick=True)


def test_the_guest_writes_a_pickle_even_of_nothing() -> None:
    command = [sys.executable, "-c", CALL, "--quick"]
    root = Path(__file__).parents[2]
    answer = subprocess.run(command, capture_output=True, check=True, cwd=root)
    assert pickle.loads(answer.stdout) == {}
