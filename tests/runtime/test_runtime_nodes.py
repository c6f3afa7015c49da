"""The table of nodes, and when a process has to end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from canbus.bus import BusError
from runtime.clock import monotonic_ns
from runtime.errors import LaunchError
from runtime.node_process import run_node_process
from runtime.nodes import NODES, STOP_ORDER, build_node, build_wires, node_entry
from runtime.plant_process import run_plant_process
from runtime.process_settings import ProcessSettings
from runtime.stopping import LAUNCHER_PID_VARIABLE, StopRequest
from vehicles import load_vehicle


def settings(**given: str) -> ProcessSettings:
    options = {
        "name": "steering",
        "vehicle": "tabby_evo",
        "interface": "virtual",
        "channel": "a",
        "harness_channel": "b",
    }
    return ProcessSettings(**{**options, **given})  # type: ignore[arg-type]


@pytest.mark.parametrize("name", NODES)
def test_every_node_of_the_table_can_be_built_with_its_wires(name: str) -> None:
    assert build_node(name, load_vehicle("tabby_evo")).name == NODES[name].node
    assert all(0x200 < can_id < 0x300 for can_id in build_wires(name).acceptance)


def test_a_process_holds_its_own_node_alone() -> None:
    code = (
        "import sys; from runtime.nodes import build_node; from vehicles import load_vehicle; "
        "build_node('steering', load_vehicle('tabby_evo')); "
        "print(*[m for m in sys.modules if m.startswith(('ecus.', 'safety', 'gateway'))])"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "ecus.steering.ecu" in output
    assert {module.split(".")[1] for module in output if "." in module} == {"common", "steering"}


def test_nodes_step_at_different_times_of_the_cycle() -> None:
    phases = [entry.phase_ns for entry in NODES.values()]
    assert len(set(phases)) == len(phases)


def test_brake_and_plant_are_ended_last() -> None:
    assert STOP_ORDER[-2:] == ("brake_servo", "plant")


def test_unknown_node_is_refused_with_what_is_allowed() -> None:
    with pytest.raises(LaunchError, match=r"'clutch' is not known: allowed .*brake_servo.*plant"):
        node_entry("clutch")


@pytest.mark.parametrize("run", [run_node_process, run_plant_process])
def test_unknown_vehicle_is_refused_by_name(run: object) -> None:
    assert callable(run)
    with pytest.raises(LaunchError, match="hovercraft"):
        run(settings(vehicle="hovercraft"), lambda event: None)


def test_a_bus_that_cannot_be_opened_is_refused() -> None:
    with pytest.raises(BusError, match="nosuchbus"):
        run_node_process(settings(interface="nosuchbus"), lambda event: None)


@pytest.mark.wall_clock
def test_a_node_in_a_process_ends_on_sigterm_with_success() -> None:
    code = (
        "from runtime.node_process import run_node_process\n"
        "from runtime.process_settings import ProcessSettings\n"
        "result = run_node_process(ProcessSettings(name='steering', vehicle='tabby_evo', "
        "interface='virtual', channel='a', harness_channel='b'), "
        "lambda event: print(event.text, flush=True))\n"
        "print('steps', result.steps, flush=True)\n"
        "raise SystemExit(result.exit_code)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        while process.stdout.readline().startswith("no real-time priority"):
            pass  # the node's own first event tells that it runs
        process.send_signal(signal.SIGTERM)
        rest = process.stdout.read()
        assert process.wait(10.0) == 0
    assert int(rest.split("steps ")[1]) > 0


def test_stop_is_requested_by_signals_and_the_old_handlers_come_back() -> None:
    old = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    with StopRequest() as stop:
        assert not stop.is_set()
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.is_set() and stop.count == 1
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.count == 2
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == old


def test_a_child_ends_when_its_launcher_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LAUNCHER_PID_VARIABLE, str(os.getppid()))
    assert not StopRequest().is_set()
    monkeypatch.setenv(LAUNCHER_PID_VARIABLE, str(os.getppid() + 1))
    assert StopRequest().is_set()


def test_a_node_started_by_hand_needs_no_launcher(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(LAUNCHER_PID_VARIABLE, raising=False)
    assert not StopRequest().is_set()


def test_the_clock_never_goes_back() -> None:
    times = [monotonic_ns() for _ in range(1_000)]
    assert times == sorted(times)
