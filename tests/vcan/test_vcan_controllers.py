"""Two SJA1000 controllers on one wire: can0 and can1, 500 kbit/s, the kernel's own driver.

The emulated wire carries frames at once, whatever the bit rates at its ends, needs nobody who
acknowledges, and makes no errors; its controllers know no error counters, no bus-off, and loop
nothing back. So error frames of the wire and bus-off are injected here (on `vcan0` in
`test_vcan_faults.py`), and the restart after bus-off is checked as far as the driver itself
decides it. What is real is the driver, its configuration, and the overflow of the receive FIFO.
Bit timing, arbitration and bus-off on a wire are the simulation's subject, and a real bus's.
"""

from __future__ import annotations

import json
import signal
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from dbc.messages import Mode
from tests.vcan.shell import run
from tests.vcan.stack import PLANNER, Stack, pause

ACROSS = ("supervisor", "safety_monitor", PLANNER)
"""These are on can1, the actuators on can0: every drive crosses the wire."""


@pytest.fixture(scope="module")
def module_stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    folder = tmp_path_factory.mktemp("controllers")
    with Stack(folder, channel="can0", channels=dict.fromkeys(ACROSS, "can1")) as stack:
        yield stack


def link(name: str) -> dict[str, Any]:
    """What `ip` says of a network."""
    text = run(f"ip -json -details -statistics link show {name}")
    answer: list[dict[str, Any]] = json.loads(text)
    return answer[0]


def test_the_car_drives_and_stops_over_two_controllers(parked: Stack) -> None:
    before = {name: link(name) for name in ("can0", "can1")}
    parked.drive()
    pause(0.5)
    assert parked.mode is Mode.AUTOMATIC
    assert parked.planner.attempt("disengage") is None
    assert abs(parked.truth().speed_mps) < 0.05
    for name in ("can0", "can1"):
        now = link(name)
        details = now["linkinfo"]["info_data"]
        assert details["state"] == "ERROR-ACTIVE"
        assert details["bittiming"]["bitrate"] == 500_000
        for way in ("rx", "tx"):
            assert now["stats64"][way]["packets"] > before[name]["stats64"][way]["packets"] + 100
            assert now["stats64"][way]["errors"] == before[name]["stats64"][way]["errors"]
            assert now["stats64"][way]["dropped"] == before[name]["stats64"][way]["dropped"]


def test_a_controller_switched_off_stops_the_car_on_both_sides(driving: Stack) -> None:
    run("ip link set can1 down")
    try:
        driving.brakes()
    finally:
        run("ip link set can1 up")
    pause(0.3)
    driving.recover()
    driving.drive()
    assert driving.mode is Mode.AUTOMATIC


PCI_COMMAND, PCI_COMMAND_INTX_DISABLE = 4, 0x400
"""Of every PCI device's configuration space: its interrupt line is held back."""


@contextmanager
def interrupts_held_back(name: str) -> Iterator[None]:
    """As on a computer that is busy with something else: the controller fills up meanwhile."""
    with Path(f"/sys/class/net/{name}/device/config").open("r+b", buffering=0) as config:

        def write(command: int) -> None:
            config.seek(PCI_COMMAND)
            config.write(struct.pack("<H", command))

        config.seek(PCI_COMMAND)
        (command,) = struct.unpack("<H", config.read(2))
        write(command | PCI_COMMAND_INTX_DISABLE)
        try:
            yield
        finally:
            write(command)


def test_a_restart_after_bus_off_is_the_drivers_after_100_ms_and_nobody_elses(
    parked: Stack,
) -> None:
    details = link("can0")["linkinfo"]["info_data"]
    assert details["restart_ms"] == 100
    by_hand = ["ip", "link", "set", "can0", "type", "can", "restart"]
    refusal = subprocess.run(by_hand, capture_output=True, text=True, check=False)
    assert refusal.returncode != 0 and "Invalid argument" in refusal.stderr


def test_an_overflow_of_the_receive_fifo_is_reported_by_every_node_behind_it(
    parked: Stack,
) -> None:
    before = link("can0")["stats64"]["rx"]
    with interrupts_held_back("can0"):
        pause(0.03)  # three cycles: some 20 frames for a FIFO that holds four
    now = link("can0")["stats64"]["rx"]
    assert now["over_errors"] > before.get("over_errors", 0)
    for name in ("steering", "throttle", "brake_servo"):
        parked.event(name, "overflows of the controller's receive buffer so far")
        parked.event(name, "error frames of the controller so far: trouble in the controller")


def test_a_controller_that_is_not_served_stops_the_car(driving: Stack) -> None:
    with interrupts_held_back("can0"):
        driving.wait(lambda: driving.truth().brake_ratio > 0.9, 1.0)
    driving.brakes()
    pause(0.3)
    assert driving.mode is not Mode.AUTOMATIC


def test_an_error_frame_is_counted_and_told_in_words(parked: Stack) -> None:
    """Injected: what its sender's own computer hears as an error, the wire carries as 0x020."""
    run("cansend can0 20000020#0000000000000000")
    for name in ("steering", "throttle", "brake_servo"):
        parked.event(name, "error frames of the controller so far: ")
        parked.event(name, "nobody acknowledged")


def test_frames_that_a_stopped_node_missed_are_counted_and_told(parked: Stack) -> None:
    parked.kill("steering", signal.SIGSTOP)
    run("cangen can1 -g 0 -I 184 -L 8 -n 1500")  # its queue has room for 639
    parked.kill("steering", signal.SIGCONT)
    parked.event("steering", "frames lost in the kernel's receive queue so far")


def test_a_controller_that_listens_only_is_heard_by_nobody(driving: Stack) -> None:
    run("ip link set can1 down")
    run("ip link set can1 up type can listen-only on")
    try:
        driving.brakes()
        before = link("can1")["stats64"]
        pause(0.2)
        now = link("can1")["stats64"]
        assert now["rx"]["packets"] > before["rx"]["packets"]
        assert now["tx"]["packets"] == before["tx"]["packets"]
        assert now["tx"]["dropped"] > before["tx"]["dropped"]
    finally:
        run("ip link set can1 down")
        run("ip link set can1 up type can listen-only off")
