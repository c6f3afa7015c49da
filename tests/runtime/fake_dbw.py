"""Stands in for the command line: `fake_dbw.py ecu NAME ...` runs until it is told to end.

Writes `NAME up` and `NAME down` into $FAKE_DBW_LOG. $FAKE_DBW_DIES names a node that ends at once,
$FAKE_DBW_DEAF one that does not listen to SIGTERM. With $FAKE_DBW_STAYS none minds the launcher's
death. Each pings its launcher until it gets SIGUSR1, or not at all with $FAKE_DBW_MUTE.
"""

import contextlib
import os
import signal
import socket
import sys
import threading

name = sys.argv[2]
done = threading.Event()
mute = threading.Event()
if "FAKE_DBW_MUTE" in os.environ:
    mute.set()


def say(text: str) -> None:
    with open(os.environ["FAKE_DBW_LOG"], "a") as log:
        log.write(f"{name} {text}\n")


if os.environ.get("FAKE_DBW_DIES") == name:
    sys.exit(3)
if os.environ.get("FAKE_DBW_DEAF") == name:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
else:
    signal.signal(signal.SIGTERM, lambda number, frame: done.set())
signal.signal(signal.SIGUSR1, lambda number, frame: mute.set())
say("up " + " ".join(sys.argv[3:]))
while not done.wait(0.02):
    if not mute.is_set():
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as ping,
        ):
            ping.sendto(b"WATCHDOG=1", os.environ["NOTIFY_SOCKET"].replace("@", "\0", 1))
    is_orphan = os.getppid() != int(os.environ["DBW_LAUNCHER_PID"])
    if is_orphan and "FAKE_DBW_STAYS" not in os.environ:
        say("orphan")
        sys.exit(1)
say("down")
