"""The unit files and docs/hardware.md against the command line and the code."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from canbus.node import PERIOD_NS
from dbw.failures import EXIT_INTERRUPTED
from runtime.nodes import STOP_ORDER
from runtime.process_stack import HANG_NS, STANDSTILL_S_MAX, TERMINATE_S_MAX
from runtime.realtime import POLICIES, RealtimeSettings
from telemetry.why.freeze import default_folder
from tests.dbw.command_lines import options
from vehicles import load_vehicle

ROOT = Path(__file__).parents[2]
UNITS = ROOT / "deploy" / "systemd"
HARDWARE = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
BITRATE_BPS = round(load_vehicle("tabby_evo").bus.bitrate_bps)


def unit(name: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(interpolation=None, delimiters="=", comment_prefixes="#")
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string((UNITS / name).read_text(encoding="utf-8"))
    return parser


SERVICE = unit("dbw.service")["Service"]
STARTED = options(SERVICE["ExecStart"])


def test_the_service_starts_the_nodes_of_a_car_and_no_simulated_one() -> None:
    assert STARTED["plant"] == "none"
    assert STARTED["channel"] == unit("80-can0.network")["Match"]["Name"]
    assert STARTED["harness_channel"] == unit("80-vcan1.netdev")["NetDev"]["Name"]


def test_limits_are_wide_enough_for_what_is_asked_by_name() -> None:
    scheduling = RealtimeSettings(scheduling=str(STARTED["scheduling"])).scheduling
    policy, _, priority = scheduling.partition(":")
    assert policy in POLICIES and int(SERVICE["LimitRTPRIO"]) >= int(priority)
    assert STARTED["lock_memory"] and SERVICE["LimitMEMLOCK"] == "infinity"


def test_the_watchdog_leaves_the_other_nodes_the_time_to_stop_the_car() -> None:
    assert SERVICE["Type"] == "notify"
    assert float(SERVICE["WatchdogSec"]) >= STANDSTILL_S_MAX + HANG_NS / 1e9
    assert float(SERVICE["WatchdogSec"]) >= 100 * PERIOD_NS / 1e9
    assert "after 10 s\nwithout a ping" in HARDWARE and float(SERVICE["WatchdogSec"]) == 10.0


def test_the_launcher_alone_is_told_to_stop_and_has_the_time_for_the_right_order() -> None:
    assert SERVICE["KillMode"] == "mixed" and SERVICE["WatchdogSignal"] == "SIGTERM"
    longest_s = STANDSTILL_S_MAX + len(STOP_ORDER) * TERMINATE_S_MAX
    assert float(SERVICE["TimeoutStopSec"]) > longest_s


def test_mistakes_are_not_repeated_and_failures_only_a_few_times() -> None:
    assert SERVICE["RestartPreventExitStatus"] == "2" and SERVICE["Restart"] == "on-failure"
    limits = unit("dbw.service")["Unit"]
    assert "starts a new one, three\ntimes a minute at most" in HARDWARE
    assert (int(limits["StartLimitBurst"]), int(limits["StartLimitIntervalSec"])) == (3, 60)


def test_the_bus_has_the_vehicles_bitrate_and_comes_back_after_bus_off() -> None:
    can = unit("80-can0.network")["CAN"]
    assert int(can["BitRate"]) == BITRATE_BPS
    assert can["RestartSec"] == "100ms" and can["SamplePoint"] == "87.5%"


WATCHER = unit("dbw-why.service")["Service"]


def test_a_watcher_keeps_freeze_frames_of_the_same_bus_and_stays_out_of_the_nodes_way() -> None:
    started = options(WATCHER["ExecStart"])
    assert started["live"] and not started["no_store"] and started["store"] is None
    assert (started["interface"], started["channel"]) == (STARTED["interface"], STARTED["channel"])
    name, _, home = WATCHER["Environment"].partition("=")
    assert default_folder({name: home}).is_relative_to(Path("/var/lib") / WATCHER["StateDirectory"])
    assert not {*WATCHER["CPUAffinity"].split()} & {*SERVICE["CPUAffinity"].split()}
    assert WATCHER["User"] == SERVICE["User"]
    assert int(WATCHER["SuccessExitStatus"]) == EXIT_INTERRUPTED


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd-analyze is not installed")
@pytest.mark.parametrize("name", ["dbw.service", "dbw-why.service"])
def test_systemd_understands_the_service(tmp_path: Path, name: str) -> None:
    text = (UNITS / name).read_text(encoding="utf-8")
    text = re.sub(r"ExecStart=\S+", f"ExecStart={shutil.which('true')}", text)
    file = tmp_path / name
    file.write_text(text.replace("User=dbw", "User=root"), encoding="utf-8")
    done = subprocess.run(
        ["systemd-analyze", "verify", str(file)], capture_output=True, text=True, check=False
    )
    said = [line for line in done.stderr.splitlines() if name in line]
    assert said == []


def test_the_hardware_guide_names_files_and_the_vehicles_bitrate() -> None:
    assert f"bitrate {BITRATE_BPS} " in HARDWARE
    for name in re.findall(r"deploy/systemd/([\w.-]+)", HARDWARE):
        assert (UNITS / name).exists(), name
    for target in re.findall(r"\]\(([^)#]+)\)", HARDWARE):
        assert target.startswith("http") or (ROOT / "docs" / target).exists(), target
