"""`dbw monitor`: its command line, its lines, and its screen in a terminal."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import pyte
import pytest

from canbus.heard import Heard
from canbus.listener import PythonCanListener
from dbw.main import main
from dbw.monitor_screen import DRAW_NS, LiveMonitor
from dbw.terminal import LEAVE, Terminal, parse_keys
from telemetry.monitor.selection import Selection
from tests.telemetry.monitored import FOREIGN_DBC, S, heard, interpreter, steering

Capture = pytest.CaptureFixture[str]

LOG = """(1.000000) vcan0 182#B83800004000A0FF
(1.010000) vcan0 702#05
(1.020000) vcan1 7DF#0201
(1.030000) vcan0 20000040#0000000000000000
"""


@pytest.fixture
def log(tmp_path: Path) -> str:
    path = tmp_path / "drive.log"
    path.write_text(LOG, encoding="ascii")
    return str(path)


def run(capsys: Capture, *arguments: str, code: int = 0) -> tuple[list[str], str]:
    """Lines on standard output, and standard error."""
    assert main(["monitor", *arguments]) == code
    shown = capsys.readouterr()
    return shown.out.splitlines(), shown.err


def test_a_log_is_shown_with_its_meaning(capsys: Capture, log: str) -> None:
    lines, err = run(capsys, "-tz", "--log", log)
    assert len(lines) == 4 and err == ""
    assert lines[0].startswith(" (000.000000)  vcan0  182   [8]  B8 38 00 00 40 00 A0 FF ")
    assert "STEER_STATUS" in lines[0]
    assert lines[1].endswith("heartbeat of Steering: operational")
    assert lines[2] == " (000.020000)  vcan1  7DF   [2]  02 01"
    assert lines[3].endswith("ERRORFRAME  BUS-OFF")


def test_the_drives_of_a_car_are_told_by_name(capsys: Capture, tmp_path: Path) -> None:
    path = tmp_path / "drives.log"
    path.write_text("(1.000000) vcan0 313#0F00FA040000\n", encoding="ascii")
    lines, _ = run(capsys, "--log", str(path), "--vehicle", "baja_5b")
    assert lines[0].endswith(
        "RPDO2 of RightWheelDrive: enable operation; target velocity 1274 rpm"
    )
    lines, _ = run(capsys, "--log", str(path))
    assert lines[0].endswith("RPDO2 of node 19")
    assert run(capsys, "--log", str(path), "--vehicle", "beetle", code=2)[1].count("\n") == 1


def test_the_log_format_gives_the_log_back(capsys: Capture, log: str) -> None:
    lines, _ = run(capsys, "-L", "--log", log)
    assert lines == LOG.replace("(1.", "(0000000001.").splitlines()


def test_channels_filters_and_names_choose_lines(capsys: Capture, log: str) -> None:
    assert len(run(capsys, "--log", log, "vcan1")[0]) == 1
    assert len(run(capsys, "--log", log, "vcan0,700:700,#0", "vcan1,0~0")[0]) == 1
    assert len(run(capsys, "--log", log, "--node", "Steering")[0]) == 2
    assert len(run(capsys, "--log", log, "--raw", "-n", "3")[0]) == 3


def test_standard_input_is_read_and_lines_come_as_they_are_written() -> None:
    command = [sys.executable, "-m", "dbw", "monitor", "--log", "-"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None and process.stdout is not None
        for line in LOG.splitlines():
            process.stdin.write(line.encode() + b"\n")
            process.stdin.flush()
            assert process.stdout.readline().split()[1] in line.replace("#", " ").encode()
        process.stdin.close()
        assert process.stdout.read() == b""
    assert process.returncode == 0


def test_a_last_line_without_an_end_is_read_and_wrong_lines_are_told(
    capsys: Capture, tmp_path: Path
) -> None:
    path = tmp_path / "cut.log"
    path.write_text("\nnonsense\n" + LOG + "(2.0) vcan0 123#1", encoding="ascii")
    lines, err = run(capsys, "--log", str(path))
    assert len(lines) == 4
    assert err == f"dbw: {path}: 2 lines are no frames, the first is line 2\n"
    path.write_text(LOG.rstrip(), encoding="ascii")
    assert len(run(capsys, "--log", str(path))[0]) == 4


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["vcan0,123"], "filter '123' of 'vcan0,123': allowed ID:MASK"),
        (["vcan0", "vcan0,1:1"], "a channel is named twice"),
        (["--message", "STER_STATUS"], "no message 'STER_STATUS': nearest STEER_STATUS"),
        (["--signal", "mod"], "no signal 'mod': nearest mode"),
        (["--node", "Steerin"], "no node 'Steerin': nearest Steering"),
        (["--dbc", "nowhere.dbc"], "nowhere.dbc: cannot be read"),
        (["--log", "nowhere.log"], "nowhere.log: No such file"),
        (["--log", "."], ".: Is a directory"),
        (["--live", "-L"], "--live and -L: the screen shows a bus"),
        (["--live", "--log", "x"], "--live and --log"),
        (["--live"], "--live needs a terminal"),
        (["--interface", "nonsense"], "unknown interface name"),
        (["-n", "0"], "a whole number from 1"),
        (["-t", "x"], "'x' is not one of"),
        (["--bitrate", "0"], "a whole number from 1 to 1000000"),
    ],
)
def test_a_mistake_is_one_line_that_names_what_is_allowed(
    arguments: list[str], error: str, capsys: Capture
) -> None:
    lines, err = run(capsys, *arguments, code=2)
    assert lines == [] and err.count("\n") == 1
    assert err.startswith("dbw: error: ") and error in err


def test_a_file_that_is_no_log_is_refused(capsys: Capture, tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(bytes(range(256)))
    _, err = run(capsys, "--log", str(path), code=2)
    assert "no line is one of candump -L" in err


def test_a_broken_dbc_is_named_with_line_and_taken_when_relaxed(
    capsys: Capture, tmp_path: Path
) -> None:
    dbc, log = tmp_path / "broken.dbc", tmp_path / "x.log"
    text = FOREIGN_DBC.replace(' SG_ gear : 16|4', ' SG_ gear : 2|4')
    dbc.write_text(text, encoding="utf-8")
    log.write_text("(1.0) can0 100#9C0101500A000000\n", encoding="ascii")
    _, err = run(capsys, "--dbc", str(dbc), "--log", str(log), code=2)
    assert f"{dbc}: line " in err and "overlapping" in err
    lines, err = run(capsys, "--dbc", str(dbc), "--log", str(log), "--relaxed")
    assert "ENGINE  speed=103 rpm" in lines[0] and "overlapping" in err


@pytest.mark.parametrize(
    ("color", "no_color", "is_coloured"),
    [("always", "1", True), ("never", "", False), ("auto", "", False), ("auto", "1", False)],
)
def test_colours_are_for_terminals_unless_asked_for(
    color: str, no_color: str, is_coloured: bool, capsys: Capture, log: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setenv("NO_COLOR", no_color)
    lines, _ = run(capsys, "--color", color, "--log", log)
    assert any("\x1b[" in line for line in lines) is is_coloured


class FakeListener:
    """Frames by hand; `lost` and notes as well."""

    def __init__(self, *batches: list[Heard]) -> None:
        self.batches = list(batches)
        self.lost = 0
        self.said: list[str] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        pass

    def hear(self, timeout_ns: int) -> list[Heard]:
        return self.batches.pop(0) if self.batches else []

    def notes(self) -> list[str]:
        said, self.said = self.said, []
        return said


def test_losses_and_failing_channels_are_told_on_stderr(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    listener = FakeListener([heard("123#11")], [heard("123#12")])
    listener.lost, listener.said = 7, ["vcan0: gone"]
    monkeypatch.setattr("dbw.monitor.listener_of", lambda *_: listener)
    lines, err = run(capsys, "-n", "2", "can0")
    assert len(lines) == 2
    assert err.splitlines() == [
        "dbw: 7 frames lost, not read in time (7 in all)", "dbw: vcan0: gone",
    ]  # fmt: skip


def test_a_silent_bus_ends_after_the_time_given(capsys: Capture) -> None:
    lines, err = run(capsys, "--interface", "virtual", "silent", "-T", "20")
    assert (lines, err) == ([], "")


def test_other_interfaces_are_heard_through_python_can(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    from canbus.frame import Frame
    from canbus.python_can_bus import PythonCanBus
    from runtime.clock import monotonic_ns

    enter = PythonCanListener.__enter__

    def enter_and_send(self: PythonCanListener) -> PythonCanListener:
        opened = enter(self)
        with PythonCanBus("virtual", "heard", clock=monotonic_ns) as bus:
            bus.send(Frame(0x702, b"\x05"))
        return opened

    monkeypatch.setattr(PythonCanListener, "__enter__", enter_and_send)
    lines, _ = run(capsys, "--interface", "virtual", "heard", "-n", "1")
    assert lines == [
        "  heard  702   [1]  05                         STEER_HEARTBEAT  "
        "heartbeat of Steering: operational"
    ]


def test_nothing_heavy_is_imported_to_read_our_own_bus(log: str) -> None:
    code = (
        "import sys; from dbw.main import main;"
        f"main(['monitor', '--log', {log!r}]);"
        "print([m for m in ('numpy', 'can', 'cantools', 'canopen', 'rich', 'configparser',"
        "'importlib.metadata') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


class Tty:
    """Both ends of a pseudo-terminal, and what a person would see on it."""

    def __init__(self, width: int = 130, height: int = 40) -> None:
        self.master, self.slave = pty.openpty()
        self.resize(width, height)
        self.before = termios.tcgetattr(self.slave)
        self.raw = b""

    def resize(self, width: int, height: int) -> None:
        self.screen = pyte.Screen(width, height)
        self.stream = pyte.ByteStream(self.screen)
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", height, width, 0, 0))

    def read(self) -> list[str]:
        """Takes in what was written; answers the lines on the screen."""
        os.set_blocking(self.master, False)
        try:
            while data := os.read(self.master, 1 << 16):
                self.raw += data
                self.stream.feed(data)
        except BlockingIOError:
            pass
        return [line.rstrip() for line in self.screen.display]

    def is_as_before(self) -> bool:
        return termios.tcgetattr(self.slave) == self.before and self.raw.endswith(LEAVE.encode())


@pytest.fixture
def tty() -> Iterator[Tty]:
    tty = Tty()
    yield tty
    os.close(tty.master)
    os.close(tty.slave)


class Clock:
    """Time by hand; each step of the screen takes as long as until the next picture."""

    now_ns = 100 * S

    def __call__(self) -> int:
        self.now_ns += DRAW_NS
        return self.now_ns


def live(listener: FakeListener, terminal: Terminal) -> LiveMonitor:
    clock = Clock()
    return LiveMonitor(
        listener=listener,
        terminal=terminal,
        interpreter=interpreter(),
        selection=Selection(),
        channels=["can0"],
        bitrate_bps=500_000,
        clock=clock,
        realtime=lambda: clock.now_ns,
    )


def terminal_on(tty: Tty, *, with_colours: bool = True) -> Terminal:
    return Terminal(tty.slave, tty.slave, with_colours=with_colours)


def test_the_screen_shows_the_bus_obeys_keys_and_gives_the_terminal_back(tty: Tty) -> None:
    listener = FakeListener([steering(0.5, 1)], [steering(0.75, 2)])
    with terminal_on(tty) as terminal:
        monitor = live(listener, terminal)
        monitor.step()
        assert any("182 STEER_STATUS" in line for line in tty.read())
        assert tty.read()[0].startswith("can0")
        os.write(tty.master, b"jj/\x1b")
        monitor.step()
        text = "\n".join(tty.read())
        assert "STEER_STATUS of Steering" in text and "steering_wheel_angle_rad=0.75 rad" in text
        os.write(tty.master, b"q")
        monitor.run()
    tty.read()
    assert tty.is_as_before()
    assert monitor.frames == 2


def test_only_lines_that_changed_are_written(tty: Tty) -> None:
    with terminal_on(tty, with_colours=False) as terminal:
        monitor = live(FakeListener([heard("7DF#00")]), terminal)
        monitor.step()
        tty.read()
        tty.raw = b""
        monitor.step()
        tty.read()
        assert b"load" in tty.raw or b"7DF" in tty.raw
        assert b"STEER_STATUS" not in tty.raw and b"\x1b[2J" not in tty.raw


def test_a_terminal_of_another_size_is_drawn_anew(tty: Tty) -> None:
    with terminal_on(tty) as terminal:
        monitor = live(FakeListener([steering()]), terminal)
        monitor.step()
        tty.read()
        tty.resize(80, 24)
        monitor.step()
        lines = tty.read()
        assert len(lines) == 24 and any("STEER_STATUS" in line for line in lines)
        assert lines[-1].startswith("sorted by id")


def test_an_exception_gives_the_terminal_back(tty: Tty) -> None:
    with pytest.raises(ZeroDivisionError), terminal_on(tty):
        assert termios.tcgetattr(tty.slave) != tty.before
        raise ZeroDivisionError
    tty.read()
    assert tty.is_as_before()


def test_a_terminal_that_is_gone_ends_the_screen(
    tty: Tty, monkeypatch: pytest.MonkeyPatch
) -> None:
    with terminal_on(tty) as terminal:
        monitor = live(FakeListener(), terminal)
        monkeypatch.setattr(terminal, "keys", lambda timeout_s: (_ for _ in ()).throw(EOFError))
        monitor.run()


def test_losses_and_notes_are_on_the_screen(tty: Tty) -> None:
    listener = FakeListener()
    listener.lost, listener.said = 3, ["can0: Network is down"]
    with terminal_on(tty) as terminal:
        monitor = live(listener, terminal)
        monitor.step()
        monitor.step()
        text = "\n".join(tty.read())
    assert "3 frames lost" in text and "can0: Network is down" in text


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("aZ ", ["a", "Z", " "]),
        ("\x1b[A\x1bOB\x1b[5~\x1b[6~", ["up", "down", "pgup", "pgdn"]),
        ("\x1b", ["esc"]),
        ("\x1b\x1b[H", ["esc", "home"]),
        ("\r\x7f", ["enter", "backspace"]),
        ("\x1b[1;5C\x1b[23~x", ["x"]),
        ("\x1b[", []),
        ("ä", ["ä"]),
    ],
)
def test_what_is_typed_becomes_keys(text: str, keys: list[str]) -> None:
    assert parse_keys(text) == keys


ENDS: dict[str, tuple[Any, int]] = {
    "q": (b"q", 0),
    "Ctrl-C": (b"\x03", 130),
    "SIGTERM": (signal.SIGTERM, 130),
    "SIGINT": (signal.SIGINT, 130),
}


@pytest.mark.parametrize("end", ENDS)
def test_however_it_ends_the_terminal_is_as_before(end: str) -> None:
    """The whole command, in a terminal of its own."""
    pid, master = pty.fork()
    if pid == 0:
        command = [sys.executable, "-m", "dbw", "monitor", "--live", "--interface", "virtual", "x"]
        os.execv(sys.executable, command)
    fcntl.ioctl(master, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    before = termios.tcgetattr(master)
    written = b""
    while b"sorted by" not in written:
        written += os.read(master, 1 << 16)
    how, code = ENDS[end]
    if isinstance(how, bytes):
        os.write(master, how)
    else:
        os.kill(pid, how)
    try:
        while data := os.read(master, 1 << 16):
            written += data
            if LEAVE.encode() in written:
                after = termios.tcgetattr(master)
    except OSError:
        pass  # the other end is closed
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == code
    os.close(master)
    assert LEAVE.encode() in written and after == before
    rest = written.rpartition(LEAVE.encode())[2].decode()
    assert rest.strip() == ("" if code == 0 else "dbw: interrupted")
    assert io.StringIO(rest).read().count("Traceback") == 0
