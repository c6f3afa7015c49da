"""The machine's conversation with QEMU, played by a script that does as each test says."""

from __future__ import annotations

import io
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from runtime.vm import Image, Machine, MachineSettings, VmError, machine, run

IMAGE = Image(kernel=Path("/vmlinuz"), initramfs=Path("/initramfs.gz"))
PRELUDE = """\
import os, re, signal, sys
line = " ".join(sys.argv)
job = re.search(r"local,path=(\\S+),mount_tag=job,", line)[1]
ports = {name: open(f"/dev/fd/{number}", "wb", buffering=0)
         for name, number in re.findall(r"file,id=(\\S+),path=/dev/fd/(\\d+)", line)}
def write(name, text):
    with open(f"{job}/new", "w") as file: file.write(text)
    os.rename(f"{job}/new", f"{job}/{name}")
"""
BOOT_S_MAX = 120.0
HANG = "write('console', 'booting\\nstuck'); signal.pause()"


class Fake:
    """A program called qemu-system-x86_64, first on the path, and the folder for jobs."""

    def __init__(self, folder: Path) -> None:
        self.jobs = folder / "jobs"
        self.jobs.mkdir()
        self._pid_file = folder / "pid"
        self._program = folder / "qemu-system-x86_64"

    def does(self, script: str) -> None:
        noted = f"open({str(self._pid_file)!r}, 'w').write(str(os.getpid()))"
        self._program.write_text(f"#!{sys.executable} -IS\n{PRELUDE}{noted}\n{script}\n")
        self._program.chmod(0o755)

    def pid(self) -> int:
        """Of the last one that was started, waited for."""
        while not (self._pid_file.exists() and self._pid_file.read_text()):
            pass
        return int(self._pid_file.read_text())

    def has(self, name: str) -> bool:
        """Whether a file is in the job's folder."""
        return any(self.jobs.glob(f"*/{name}"))

    def is_gone(self) -> bool:
        """Whether neither the process nor its folder is left."""
        try:
            os.kill(self.pid(), 0)
        except ProcessLookupError:
            return list(self.jobs.iterdir()) == []
        return False


@pytest.fixture
def qemu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fake]:
    """Leaves no thread, no process, no folder and no descriptor, whatever the test did."""
    fake = Fake(tmp_path)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(tempfile, "tempdir", str(fake.jobs))
    monkeypatch.setattr(machine, "LOOK_S", 0.01)
    threads, descriptors = threading.active_count(), len(os.listdir("/proc/self/fd"))
    yield fake
    assert fake.is_gone()
    assert threading.active_count() == threads
    assert len(os.listdir("/proc/self/fd")) == descriptors


def outcome(script: str, qemu: Fake) -> tuple[int | None, bytes, bytes]:
    """Exit code and output of a run."""
    out, err = io.BytesIO(), io.BytesIO()
    qemu.does(script)
    with Machine(IMAGE, MachineSettings(), ["true"], stdout=out, stderr=err) as it:
        code = it.wait()
    return code, out.getvalue(), err.getvalue()


def hurry(monkeypatch: pytest.MonkeyPatch, qemu: Fake, *, after: str, passed_s: float) -> None:
    """Time stands still until a file is in the job's folder; then so much has passed."""
    monkeypatch.setattr(
        machine, "monotonic_ns", lambda: int(passed_s * 1e9) if qemu.has(after) else 0
    )


@pytest.mark.parametrize("code", [0, 1, 127, 137, 255])
def test_exit_code_comes_through(code: int, qemu: Fake) -> None:
    assert outcome(f"write('state', 'booted'); write('exit', '{code}\\n')", qemu)[0] == code


def test_output_comes_through_byte_by_byte_and_kept_apart(qemu: Fake) -> None:
    code, out, err = outcome(
        "ports['stdout'].write(bytes(range(256)) * 4096)\n"
        "ports['stderr'].write(b'\\r\\n\\0oops')\n"
        "write('exit', '0')",
        qemu,
    )
    assert (code, out, err) == (0, bytes(range(256)) * 4096, b"\r\n\0oops")


def test_machine_is_ended_when_all_output_has_come(qemu: Fake) -> None:
    """The guest tells how much it copied, and waits: what QEMU still holds must not be lost."""
    code, out, err = outcome(
        "write('exit', '5\\n')\n"
        "write('copied.stderr', '0+0 records out\\n0 bytes copied')\n"
        "write('copied.stdout', '4+0 records out\\n400000 bytes (400 kB) copied, 1 s')\n"
        "for _ in range(4): ports['stdout'].write(b'x' * 100000)\n"
        "signal.pause()",
        qemu,
    )
    assert (code, len(out), err) == (5, 400_000, b"")


def test_output_of_a_machine_that_ends_abruptly_is_complete(qemu: Fake) -> None:
    out = io.BytesIO()
    qemu.does("ports['stdout'].write(b'x' * 60000); os.kill(os.getpid(), signal.SIGKILL)")
    with (
        Machine(IMAGE, MachineSettings(), ["true"], stdout=out, stderr=io.BytesIO()) as it,
        pytest.raises(VmError, match="the virtual machine did not boot; its last lines: nothing"),
    ):
        it.wait()
    assert out.getvalue() == b"x" * 60000


def test_command_and_folders_are_laid_out_for_the_guest(qemu: Fake, tmp_path: Path) -> None:
    odd = tmp_path / "odd \udcff"
    odd.mkdir()
    qemu.does(
        "for name in ('command.sh', 'start.sh', 'writable'):\n"
        "    ports['stdout'].write(open(f'{job}/{name}', 'rb').read())\n"
        "write('exit', '0')"
    )
    out = io.BytesIO()
    settings = MachineSettings(writable=(odd,))
    with Machine(IMAGE, settings, ["echo", "\udcfe"], stdout=out, stderr=io.BytesIO()) as it:
        assert it.wait() == 0
    assert b" echo '\xfe'\n" in out.getvalue()
    assert out.getvalue().endswith(os.fsencode(odd) + b"\n")
    assert b"ip link set" in out.getvalue()


def test_run_writes_to_the_programs_own_output(
    qemu: Fake, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    qemu.does(
        "ports['stdout'].write(b'out'); ports['stderr'].write(b'err'); write('exit', '3')"
    )
    assert run(IMAGE, MachineSettings(), ["true"]) == 3
    assert capfdbinary.readouterr() == (b"out", b"err")


def test_machine_that_dies_shows_the_last_lines_of_its_console(qemu: Fake) -> None:
    with pytest.raises(VmError) as caught:
        outcome(
            "write('state', 'booted')\n"
            "write('console', '\\n'.join(f'line {n}' for n in range(40)) + '\\npanic\\n\\n')",
            qemu,
        )
    lines = str(caught.value).splitlines()
    assert lines[0] == "the virtual machine died; its last lines:"
    assert lines[1] == "line 1" and lines[-1] == "panic" and len(lines) == 41


def test_machine_that_never_booted_shows_what_qemu_said(qemu: Fake) -> None:
    with pytest.raises(VmError, match=r"did not boot; its last lines:\nqemu: no memory$"):
        outcome("sys.exit('qemu: no memory')", qemu)


def test_exit_code_that_is_none_is_a_dead_machine(qemu: Fake) -> None:
    with pytest.raises(VmError, match="the virtual machine died"):
        outcome("write('state', 'booted'); write('exit', '')", qemu)


def test_command_that_takes_too_long_is_ended(
    qemu: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    hurry(monkeypatch, qemu, after="console", passed_s=3601.0)
    with pytest.raises(VmError, match=r"took longer than 3600 s; its last lines:\nbooting\nstuck$"):
        outcome(f"write('state', 'booted'); {HANG}", qemu)


def test_machine_that_does_not_boot_is_started_once_more_and_then_ended(
    qemu: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    hurry(monkeypatch, qemu, after="console", passed_s=BOOT_S_MAX + 1.0)
    out = io.BytesIO()
    qemu.does(HANG)
    with Machine(IMAGE, MachineSettings(), ["true"], stdout=out, stderr=out) as it:
        first = qemu.pid()
        with pytest.raises(
            VmError, match="did not boot within 120 s, 2 times; its last lines:\nbooting\nstuck"
        ):
            it.wait()
        assert qemu.pid() != first
    assert out.getvalue() == (
        b"dbw: the virtual machine did not boot within 120 s and is started once more; "
        b"its last lines:\nbooting\nstuck\n"
    )


def test_machine_that_boots_the_second_time_does_its_job(
    qemu: Fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hurry(monkeypatch, qemu, after="console", passed_s=BOOT_S_MAX + 1.0)
    mark = repr(str(tmp_path / "mark"))
    code, out, err = outcome(
        f"if not os.path.exists({mark}):\n    open({mark}, 'w'); {HANG}\n"
        "write('state', 'booted'); ports['stdout'].write(b'done'); write('exit', '7')",
        qemu,
    )
    assert (code, out) == (7, b"done")
    assert err.endswith(b"and is started once more; its last lines:\nbooting\nstuck\n")


def test_time_counts_from_the_machines_start_and_not_from_the_first_look(
    qemu: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    hurry(monkeypatch, qemu, after="console", passed_s=BOOT_S_MAX + 1.0)
    qemu.does(HANG)
    out = io.BytesIO()
    with Machine(IMAGE, MachineSettings(), ["true"], stdout=out, stderr=out) as it:
        while not qemu.has("console"):
            pass
        with pytest.raises(VmError, match="did not boot within 120 s"):
            it.wait()


def test_machine_that_has_booted_may_take_its_time(
    qemu: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    hurry(monkeypatch, qemu, after="state", passed_s=BOOT_S_MAX + 1.0)
    looks = iter(range(1000))
    qemu.does(f"write('state', 'booted'); {HANG}")
    out = io.BytesIO()
    with Machine(IMAGE, MachineSettings(), ["true"], stdout=out, stderr=out) as it:
        assert it.wait(lambda: qemu.has("console") and next(looks) > 5) is None


def test_machine_that_is_stopped_has_no_exit_code(qemu: Fake) -> None:
    qemu.does(HANG)
    out = io.BytesIO()
    with Machine(IMAGE, MachineSettings(), ["true"], stdout=out, stderr=out) as it:
        assert it.wait(lambda: qemu.has("console")) is None


def test_machine_that_is_deaf_to_sigterm_is_killed(
    qemu: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "END_S_MAX", 0.05)
    qemu.does(f"signal.signal(signal.SIGTERM, signal.SIG_IGN); {HANG}; {HANG}")
    out = io.BytesIO()
    with Machine(IMAGE, MachineSettings(), ["true"], stdout=out, stderr=out) as it:
        it.wait(lambda: qemu.has("console"))


def test_error_in_the_block_ends_the_machine(qemu: Fake) -> None:
    qemu.does(HANG)
    out = io.BytesIO()
    with (
        pytest.raises(KeyboardInterrupt),
        Machine(IMAGE, MachineSettings(), ["true"], stdout=out, stderr=out) as it,
    ):
        it.wait(lambda: qemu.has("console"))
        raise KeyboardInterrupt


class Closed(io.BytesIO):
    """A pipe whose reader has gone."""

    def write(self, data: object, /) -> int:
        raise BrokenPipeError


@pytest.mark.parametrize("rest", ["signal.pause()", "write('exit', '0')"])
def test_output_that_nobody_reads_ends_the_machine(rest: str, qemu: Fake) -> None:
    qemu.does(f"signal.signal(signal.SIGPIPE, signal.SIG_IGN)\nports['stdout'].write(b'y')\n{rest}")
    with (
        Machine(IMAGE, MachineSettings(), ["yes"], stdout=Closed(), stderr=io.BytesIO()) as it,
        pytest.raises(BrokenPipeError),
    ):
        it.wait()


def test_qemu_that_cannot_be_started_is_one_line(qemu: Fake, tmp_path: Path) -> None:
    qemu.does("write('exit', '0')")
    assert outcome("write('exit', '0')", qemu)[0] == 0
    (tmp_path / "qemu-system-x86_64").write_bytes(b"\x7fELF no program")
    with (
        pytest.raises(VmError, match=r"cannot start .*/qemu-system-x86_64: "),
        Machine(IMAGE, MachineSettings(), ["true"], stdout=io.BytesIO(), stderr=io.BytesIO()),
    ):
        pass
