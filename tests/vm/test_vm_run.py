"""The real machine: each boot takes some ten seconds, so one run answers most questions."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from runtime.vm import VmError, host, prepare
from tests.vm import guest

ROOT = Path(__file__).parents[2]
DBW = [sys.executable, "-m", "dbw", "vm"]
LIMIT_S = 300.0
ODD = ["", "two words", "it's", '"$HOME"', "line\nbreak", "ü", "-x", "bytes \udcff"]
FROZEN_S = 3.0

pytestmark = [pytest.mark.slow, pytest.mark.wall_clock]


@pytest.fixture(scope="module", autouse=True)
def image() -> None:
    """Tests install nothing on the host; what is there already must do."""
    missing = host.missing_packages()
    if missing:
        pytest.skip(f"the virtual machine needs {', '.join(missing)}")
    try:
        prepare()
    except VmError as error:
        pytest.skip(str(error))


def dbw(*arguments: str, **options: Any) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*DBW, *arguments], capture_output=True, cwd=ROOT, timeout=LIMIT_S,
                          check=False, **options)


def children(pid: int) -> list[int]:
    return [int(text) for text in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def qemu_of(process: subprocess.Popen[bytes]) -> int:
    """The id of QEMU's process, waited for."""
    while process.poll() is None:
        for pid in children(process.pid):
            if b"qemu-system" in Path(f"/proc/{pid}/cmdline").read_bytes():
                return pid
    raise AssertionError("no machine was started")


@pytest.fixture
def started() -> Iterator[subprocess.Popen[bytes]]:
    """A run whose command says so and then hangs."""
    command = [*DBW, "run", "--", "sh", "-c", "echo started; exec sleep 10000"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT
    ) as process:
        yield process
        process.kill()


@pytest.fixture(scope="module")
def visit(image: None, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """One run of guest.py, in a folder that stays, and what it has found."""
    folder = tmp_path_factory.mktemp("a, b")
    done = dbw(
        "run", "--writable", str(folder), "--",
        sys.executable, "-m", "tests.vm.guest", str(folder), *ODD,
        env={**os.environ, "BASH_FUNC_ODD%%": "() {  :\n}"},
    )
    found = json.loads((folder / "found.json").read_text(encoding="utf-8"))
    return {**found, "code": done.returncode, "stdout": done.stdout, "stderr": done.stderr}


def test_exit_code_and_output_come_through_byte_by_byte_and_kept_apart(visit: Any) -> None:
    assert visit["code"] == guest.CODE
    assert visit["stdout"] == guest.STDOUT
    assert visit["stderr"] == guest.STDERR


def test_arguments_environment_and_folder_arrive(visit: Any) -> None:
    arrived = [bytes.fromhex(text) for text in visit["arguments"]]
    assert arrived == [text.encode(errors="surrogateescape") for text in ODD]
    assert visit["odd"] == "() {  :\n}"
    assert visit["folder"] == str(ROOT)


def test_files_outside_of_writable_folders_vanish(visit: Any) -> None:
    assert visit["did_write"] == [True, True]
    assert not any(path.exists() for path in guest.VANISHES)


@pytest.mark.parametrize(
    "way", ["vcan0", "can0 to can1", "can1 to can0", "can0 to can1 by can-utils"]
)
def test_frame_arrives(way: str, visit: Any) -> None:
    assert visit[way] == "123#0102"


def test_reader_may_be_slow(tmp_path: Path) -> None:
    """Nobody reads while the command runs and ends; a background process is no reason to wait."""
    flood = f"{sys.executable} -m tests.vm.guest flood; sleep 10000 & echo said > /dev/stderr"
    command = [*DBW, "run", "--", "sh", "-c", flood]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stderr.readline() == b"said\n"
        assert process.stdout.read() == guest.STDOUT
        assert process.wait(LIMIT_S) == 0


def test_death_by_signal_is_128_and_its_number() -> None:
    assert dbw("run", "--", "sh", "-c", "kill -SEGV $$").returncode == 128 + signal.SIGSEGV


def test_panic_ends_with_125_and_the_consoles_last_lines() -> None:
    done = dbw("run", "--", "sh", "-c", "echo before; sleep 1; echo c > /proc/sysrq-trigger")
    assert done.returncode == 125
    assert done.stdout == b"before\n"
    assert b"the virtual machine died; its last lines:\n" in done.stderr
    assert b"sysrq triggered crash" in done.stderr.lower()


def test_command_that_takes_too_long_ends_with_125() -> None:
    done = dbw("run", "--timeout", "1", "--", "sleep", "10000")
    assert done.returncode == 125
    assert done.stderr.startswith(b"dbw: error: the virtual machine took longer than 1 s")


def test_counted_instructions_tell_the_time_whatever_the_host_does() -> None:
    """The host stops QEMU for seconds: the guest's clock stops with it."""
    laps = """
import time
begin_ns = time.monotonic_ns()
for _ in range(40):
    sum(range(300_000))
    now_ns = time.monotonic_ns()
    print(now_ns - begin_ns, flush=True)
    begin_ns = now_ns
"""
    command = [*DBW, "run", "--icount", "0", "--", sys.executable, "-c", laps]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout is not None
        found = [int(process.stdout.readline()) for _ in range(5)]
        pid = qemu_of(process)
        os.kill(pid, signal.SIGSTOP)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(FROZEN_S)
        os.kill(pid, signal.SIGCONT)
        found += [int(line) for line in process.stdout]
        assert process.wait(LIMIT_S) == 0
    assert len(found) == 40
    assert max(found[2:]) < 2 * min(found[2:]) < FROZEN_S * 1e9


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_the_machine_with_130(
    number: int, started: subprocess.Popen[bytes]
) -> None:
    assert started.stdout is not None
    pid = qemu_of(started)
    if number == signal.SIGTERM:  # the other one while it boots
        assert started.stdout.readline() == b"started\n"
    started.send_signal(number)
    _, complaints = started.communicate(timeout=LIMIT_S)
    assert started.returncode == 130 and complaints == b""
    assert not Path(f"/proc/{pid}").exists()


def test_machine_dies_with_its_parent(started: subprocess.Popen[bytes]) -> None:
    pid = qemu_of(started)
    ended = os.pidfd_open(pid)
    started.kill()
    started.wait(LIMIT_S)
    assert select.select([ended], [], [], LIMIT_S)[0] == [ended]
    os.close(ended)


def test_shell_is_at_the_terminal() -> None:
    ours, theirs = pty.openpty()
    shown = b""
    with subprocess.Popen(
        [*DBW, "shell"], stdin=theirs, stdout=theirs, stderr=theirs, cwd=ROOT
    ) as process:
        os.close(theirs)
        for expected, typed in ((rb"[#$] $", b"echo $((6*7))\n"), (rb"\r42\r", b"exit\n")):
            while not re.search(expected, shown):
                shown += os.read(ours, 4096)
            os.write(ours, typed)
        assert process.wait(LIMIT_S) == 0
    os.close(ours)
