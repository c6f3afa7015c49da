"""The machine itself: QEMU's command line, the conversation with the guest, and its end.

The guest sees the host's file system under an overlay: it may write anywhere, and nothing of it
reaches the host but what lies in `writable` folders. A folder shared for the job carries the
command in and the exit code out; standard output and error are serial ports of their own.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import BinaryIO

from runtime.clock import NS_PER_S, monotonic_ns
from runtime.vm.host import VmError, program
from runtime.vm.image import Image

BOOT_S_MAX = 120.0
"""Booting takes seconds; on a machine that computes something else, perhaps a minute."""

BOOTS_MAX = 2
"""A guest that hangs on its way up, as an emulated one rarely does, has not begun the command."""

PANIC = "Kernel panic"
LAST_LINES = 40
"""Of the guest's console, shown when it fails."""

EXIT_CANNOT_RUN = 126
"""As shells have it; here also for a folder that the guest does not have."""

END_S_MAX = 5.0
"""QEMU needs a moment; then it is killed."""

LOOK_S = 0.1
PR_SET_PDEATHSIG = 1

MEMORY_MIB_MIN = 256
"""Less, and the initramfs does not unpack."""

LEFT_OUT = frozenset({"XDG_RUNTIME_DIR", "NOTIFY_SOCKET", "WATCHDOG_USEC", "TMPDIR"})
"""Environment variables that name things of the host alone."""

GUEST_PATHS = "/usr/sbin:/sbin"
"""Behind the host's search path: `ip`, `cangw`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineSettings:
    """How the machine is to be.

    Attributes:
        cpus: processors; one when instructions are counted.
        memory_mib: of the guest.
        icount_shift: None lets the guest's clock follow the host's; n counts 2^n ns for each
            instruction and skips idle time, so that the guest's time does not depend on the
            host's load.
        accelerator: QEMU's name: tcg or kvm.
        timeout_s: the machine is ended when the command runs longer, in the host's time.
        writable: folders of the host that the command may write to.
    """

    cpus: int = 2
    memory_mib: int = 2048
    icount_shift: int | None = None
    accelerator: str = "tcg"
    timeout_s: float = 3600.0
    writable: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        """Refuses what QEMU would refuse less clearly."""
        if self.accelerator not in ("tcg", "kvm"):
            raise VmError(f"accelerator {self.accelerator!r}: allowed tcg, kvm")
        if self.icount_shift is not None and self.accelerator != "tcg":
            raise VmError("counting instructions needs the accelerator tcg")
        if self.icount_shift is not None and not 0 <= self.icount_shift <= 10:
            raise VmError(f"icount {self.icount_shift}: allowed 0 to 10")
        if self.accelerator == "kvm" and not os.access("/dev/kvm", os.R_OK | os.W_OK):
            raise VmError("accelerator kvm: /dev/kvm cannot be used; use tcg")
        if not 1 <= self.cpus <= 64:
            raise VmError(f"cpus {self.cpus}: allowed 1 to 64")
        if self.memory_mib < MEMORY_MIB_MIN:
            raise VmError(f"memory {self.memory_mib} MiB: at least {MEMORY_MIB_MIN}")
        if not self.timeout_s > 0:  # nor is NaN
            raise VmError(f"timeout {self.timeout_s:g} s: allowed above 0")
        for folder in self.writable:
            if "\n" in str(folder):
                raise VmError(f"{str(folder)!r}: a line break in the folder's name")
            if not folder.is_dir() or not os.access(folder, os.W_OK):
                raise VmError(f"{folder}: no folder that can be written to")


def qemu_command(
    image: Image, settings: MachineSettings, job: Path, output: Mapping[str, int]
) -> list[str]:
    """QEMU's command line.

    Args:
        image: what to boot.
        settings: how the machine is to be.
        job: folder shared for the job.
        output: file descriptors by port name; none: the console is the terminal.
    """
    counting = settings.icount_shift is not None
    accelerator = "kvm" if settings.accelerator == "kvm" else (
        "tcg,thread=single" if counting else "tcg,thread=multi"
    )
    command = [
        program("qemu-system-x86_64"), "-nodefaults", "-no-user-config", "-no-reboot",
        "-display", "none", "-accel", accelerator, "-cpu", "max",
        "-smp", "1" if counting else str(settings.cpus), "-m", str(settings.memory_mib),
        "-kernel", str(image.kernel), "-initrd", str(image.initramfs),
        "-append", "console=ttyS0 quiet loglevel=4 panic=-1 oops=panic",
        "-object", "can-bus,id=wire",
        "-device", "kvaser_pci,canbus=wire", "-device", "kvaser_pci,canbus=wire",
        "-device", "virtio-serial-pci",
    ]
    if counting:
        command += ["-icount", f"shift={settings.icount_shift},sleep=off"]
    if output:
        command += ["-serial", f"file:{_quoted(job / 'console')}"]
    else:
        command += ["-chardev", "stdio,id=terminal,signal=off", "-serial", "chardev:terminal"]
    for name, descriptor in output.items():
        command += ["-chardev", f"file,id={name},path=/dev/fd/{descriptor}"]
        command += ["-device", f"virtserialport,chardev={name},name={name}"]
    shares = [("host", Path("/"), "on"), ("job", job, "off")]
    shares += [(f"write{n}", path, "off") for n, path in enumerate(settings.writable)]
    for tag, path, is_readonly in shares:
        command += [
            "-virtfs",
            f"local,path={_quoted(path)},mount_tag={tag},security_model=none,readonly={is_readonly},"
            "multidevs=remap",
        ]
    return command


def _quoted(path: Path) -> str:
    """As a value in one of QEMU's lists, where commas separate."""
    return str(path).replace(",", ",,")


def command_script(
    command: Sequence[str], folder: Path, environment: Mapping[str, str]
) -> str:
    """What the guest runs: the command in the same folder with the same environment.

    Bytes that are no UTF-8 are surrogates here, as in `sys.argv` and `os.environ`.
    """
    kept = {name: value for name, value in environment.items() if name not in LEFT_OUT}
    kept["PATH"] = f"{kept.get('PATH', '/usr/bin:/bin')}:{GUEST_PATHS}"
    hint = f"dbw vm: the machine does not see {folder}; --writable shows it"
    lines = [
        f"cd {shlex.quote(str(folder))} 2> /dev/null || "
        f"{{ echo {shlex.quote(hint)} >&2; exit {EXIT_CANNOT_RUN}; }}"
    ]
    words = [f"{name}={value}" for name, value in sorted(kept.items())]
    lines.append(f"exec env -i -- {shlex.join(words)} {shlex.join(command)}")
    return "\n".join([*lines, ""])


class Machine:
    """One run of the machine. `with` starts it and leaves nothing of it behind.

    Args:
        image: what to boot.
        settings: how it is to be.
        command: what to run in it.
        interactive: the command gets the terminal; otherwise its output is passed on.
        stdout, stderr: where the command's output goes.
    """

    def __init__(
        self,
        image: Image,
        settings: MachineSettings,
        command: Sequence[str],
        *,
        interactive: bool = False,
        stdout: BinaryIO | None = None,
        stderr: BinaryIO | None = None,
    ) -> None:
        self._image = image
        self._settings = settings
        self._command = tuple(command)
        self._interactive = interactive
        self._sinks = {
            "stdout": stdout or sys.stdout.buffer,
            "stderr": stderr or sys.stderr.buffer,
        }
        self._stack = ExitStack()
        self._boots = 0
        self._threads: list[threading.Thread] = []
        self._taken = dict.fromkeys(self._sinks, 0)
        self._sink_error: OSError | ValueError | None = None

    def __enter__(self) -> Machine:
        """Starts QEMU.

        Raises:
            VmError: it cannot be started.
        """
        self._begin_ns = monotonic_ns()  # before QEMU: its own time counts
        self._boot()
        return self

    def __exit__(self, *exception: object) -> None:
        """Ends QEMU if it still runs."""
        self._end()
        self._stack.close()

    def wait(self, is_stopped: Callable[[], bool] = lambda: False) -> int | None:
        """Waits for the command's end. A guest that does not boot is started once more.

        Args:
            is_stopped: looked at all the time; true ends the wait.

        Returns:
            Its exit code, 128 + n when signal n ended it; None when stopped.

        Raises:
            VmError: the guest did not boot, panicked, hung or took longer than allowed; with the
                last lines of its console.
            OSError: the output cannot be written; BrokenPipeError when nobody reads it any more.
        """
        while self._process.poll() is None:
            if is_stopped():
                return None
            self._raise_sink_error()
            if self._is_done():
                break
            now_ns = monotonic_ns()
            if (now_ns - self._begin_ns) / NS_PER_S > self._settings.timeout_s:
                raise self._failure(f"took longer than {self._settings.timeout_s:g} s")
            is_late = (now_ns - self._boot_ns) / NS_PER_S > BOOT_S_MAX
            if is_late and not (self._job / "state").exists():
                self._boot_again()
            try:
                self._process.wait(LOOK_S)
            except subprocess.TimeoutExpired:
                continue
        self._end()
        self._raise_sink_error()
        code = self._number("exit")
        if code is None:
            did_boot = (self._job / "state").exists()
            raise self._failure("died" if did_boot else "did not boot")
        return code

    def _boot(self) -> None:
        """Starts QEMU with a new folder for the job."""
        with ExitStack() as stack:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="dbw-vm-"))
            self._job = Path(folder)
            self._write_job()
            self._boot_ns = monotonic_ns()
            self._process = self._start()
            self._stack = stack.pop_all()
        self._boots += 1

    def _boot_again(self) -> None:
        """Says why, on standard error; raises when it was the last time."""
        late = f"did not boot within {BOOT_S_MAX:g} s"
        if self._boots == BOOTS_MAX:
            raise self._failure(f"{late}, {BOOTS_MAX} times")
        why = self._failure(f"{late} and is started once more")
        self._sinks["stderr"].write(f"dbw: {why}\n".encode())
        self._sinks["stderr"].flush()
        self._stack.close()
        self._threads.clear()
        self._boot()

    def _is_done(self) -> bool:
        """Whether the command has ended, and all that it wrote has come."""
        return self._number("exit") is not None and all(
            self._number(f"copied.{name}") == taken for name, taken in self._taken.items()
        )

    def _number(self, name: str) -> int | None:
        """What the last line of a file for the job begins with, once it is there."""
        try:
            return int((self._job / name).read_text().splitlines()[-1].split()[0])
        except (OSError, ValueError, IndexError):
            return None

    def _write_job(self) -> None:
        settings = self._settings
        script = command_script(self._command, Path.cwd(), os.environ)
        start = files("runtime.vm").joinpath("start.sh").read_text(encoding="utf-8")
        (self._job / "start.sh").write_text(start, encoding="utf-8")
        (self._job / "command.sh").write_bytes(os.fsencode(script))
        folders = "".join(f"{folder.resolve()}\n" for folder in settings.writable)
        (self._job / "writable").write_bytes(os.fsencode(folders))
        if self._interactive:
            (self._job / "interactive").touch()

    def _start(self) -> subprocess.Popen[bytes]:
        readers, writers = {}, {}
        for name in () if self._interactive else self._sinks:
            readers[name], writers[name] = os.pipe()
        command = qemu_command(self._image, self._settings, self._job, writers)
        try:
            with (self._job / "qemu").open("wb") as complaints:
                process = subprocess.Popen(
                    command,
                    stdin=None if self._interactive else subprocess.DEVNULL,
                    stdout=None if self._interactive else subprocess.DEVNULL,
                    stderr=complaints,
                    pass_fds=tuple(writers.values()),
                    preexec_fn=_die_with_parent,
                    start_new_session=not self._interactive,
                )
        except OSError as error:
            for descriptor in readers.values():
                os.close(descriptor)
            raise VmError(f"cannot start {command[0]}: {error}") from error
        finally:
            for descriptor in writers.values():
                os.close(descriptor)
        for name, descriptor in readers.items():
            thread = threading.Thread(target=self._pass_on, args=(descriptor, name))
            thread.start()
            self._threads.append(thread)
        return process

    def _pass_on(self, descriptor: int, name: str) -> None:
        """Copies what comes until the guest has gone, or nobody takes it any more."""
        sink = self._sinks[name]
        with open(descriptor, "rb", buffering=0) as source:
            try:
                while chunk := source.read(65536):
                    sink.write(chunk)
                    sink.flush()
                    self._taken[name] += len(chunk)
            except (OSError, ValueError) as error:  # ValueError: the sink is closed on this side
                self._sink_error = error

    def _raise_sink_error(self) -> None:
        if self._sink_error is not None:
            raise self._sink_error

    def _end(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(END_S_MAX)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        for thread in self._threads:
            thread.join()

    def _failure(self, what: str) -> VmError:
        """An error with what the guest, or QEMU, said last."""
        self._end()
        lines: list[str] = []
        for name in ("qemu", "console"):
            path = self._job / name
            if path.exists():
                text = path.read_text(encoding="utf-8", errors="replace")
                lines += [line.rstrip() for line in text.splitlines() if line.strip()]
        panics = [number for number, line in enumerate(lines) if PANIC in line]
        begin = panics[0] if panics else max(0, len(lines) - LAST_LINES)  # its cause comes first
        last = "\n".join(["", *lines[begin : begin + LAST_LINES]]) if lines else " nothing"
        return VmError(f"the virtual machine {what}; its last lines:{last}")


def run(image: Image, settings: MachineSettings, command: Sequence[str]) -> int:
    """Runs a command in the machine; answers its exit code. Raises VmError as `Machine`."""
    with Machine(image, settings, command) as machine:
        code = machine.wait()
        assert code is not None
        return code


def _die_with_parent() -> None:
    """In the child: no machine outlives the command that started it (prctl(2))."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
