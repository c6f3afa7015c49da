"""The state file: whose process is whose, and what an old file means."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from runtime import state_file
from runtime.errors import LaunchError
from runtime.state_file import (
    ProcessRecord,
    StackState,
    boot_id,
    channel_lock,
    known_channels,
    read_state,
    record_of,
    remove_state,
    start_ticks,
    write_state,
)


@pytest.fixture(autouse=True)
def runtime_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    yield tmp_path / "can-by-wire"


def own_record(name: str = "launcher") -> ProcessRecord:
    record = record_of(name, os.getpid())
    assert record is not None
    return record


def state(channel: str = "vcan0") -> StackState:
    return StackState(
        channel=channel,
        interface="socketcan",
        harness_channel="vcan1",
        vehicle="tabby_evo",
        boot_id=boot_id(),
        launcher=own_record(),
        nodes=(own_record("plant"),),
    )


@pytest.mark.parametrize("channel", ["vcan0", "/dev/ttyUSB0", "a b/..", ".."])
def test_state_is_read_back_as_it_was_written(channel: str, runtime_folder: Path) -> None:
    write_state(state(channel))
    assert read_state(channel) == state(channel)
    assert known_channels() == [channel]
    assert [path.parent for path in runtime_folder.iterdir()] == [runtime_folder]


def test_there_is_no_state_before_it_is_written_and_after_it_is_removed() -> None:
    assert read_state("vcan0") is None
    write_state(state())
    remove_state("vcan0")
    remove_state("vcan0")
    assert read_state("vcan0") is None and known_channels() == []


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"launcher": {"pid": 1}, "nodes": []}'])
def test_a_broken_file_is_refused_by_name(text: str, runtime_folder: Path) -> None:
    runtime_folder.mkdir()
    (runtime_folder / "vcan0.json").write_text(text)
    with pytest.raises(LaunchError, match=r"vcan0\.json is not a state file"):
        read_state("vcan0")


def test_own_process_is_alive() -> None:
    assert own_record().is_alive and state().alive


def test_another_process_with_the_same_id_is_not_ours() -> None:
    record = own_record()
    assert not replace(record, start_ticks=record.start_ticks - 1).is_alive


def test_nothing_is_alive_after_the_machine_was_started_again() -> None:
    assert replace(state(), boot_id="another").alive == ()


def test_a_process_that_ended_but_was_not_reaped_is_dead() -> None:
    process = subprocess.Popen([sys.executable, "-S", "-E", "-c", "pass"])
    try:
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        assert start_ticks(process.pid) is None
    finally:
        process.wait()


def test_start_time_is_read_behind_a_name_with_brackets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fields = ["S", *(str(n) for n in range(4, 30))]
    (tmp_path / "77").mkdir()
    (tmp_path / "77" / "stat").write_text(f"77 (a ) Z (b)) {' '.join(fields)}\n")
    monkeypatch.setattr(state_file, "PROC", tmp_path)
    assert start_ticks(77) == 22


def test_a_channel_is_locked_for_one_launcher() -> None:
    write_state(state())
    with channel_lock("vcan0"):
        refused = pytest.raises(LaunchError, match=rf"'vcan0' \(launcher process {os.getpid()}\)")
        with refused, channel_lock("vcan0"):
            pass
        with channel_lock("vcan1"):
            pass
    with channel_lock("vcan0"):
        pass


def test_a_folder_that_cannot_be_used_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    with pytest.raises(LaunchError, match="XDG_RUNTIME_DIR"):
        read_state("vcan0")


def test_a_folder_of_another_user_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    write_state(state())
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(LaunchError, match="another user"):
        read_state("vcan0")
