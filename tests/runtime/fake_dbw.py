"""Stands in for the command line: `fake_dbw.py ecu NAME ...` runs until it is told to end.

Writes `NAME up` and `NAME down` into $FAKE_DBW_LOG. $FAKE_DBW_DIES names a node that ends at once,
$FAKE_DBW_DEAF one that does not listen to SIGTERM. With $FAKE_DBW_STAYS none minds the launcher's
death. Each pings its launcher until it gets SIGUSR1, or not at all with $FAKE_DBW_MUTE.

The signals are waited for, not handled: a handler that sets an `Event` hangs for ever when it comes
while the main thread has the event's lock.
"""

import contextlib
import os
import signal
import socket
import sys

TOLD = (signal.SIGTERM, signal.SIGUSR1)

name = sys.argv[2]
is_mute = "FAKE_DBW_MUTE" in os.environ
is_deaf = os.environ.get("FAKE_DBW_DEAF") == name


def say(text: str) -> None:
    with open(os.environ["FAKE_DBW_LOG"], "a") as log:
        log.write(f"{name} {text}\n")


if os.environ.get("FAKE_DBW_DIES") == name:
    sys.exit(3)
signal.pthread_sigmask(signal.SIG_BLOCK, TOLD)
say("up " + " ".join(sys.argv[3:]))
while True:
    told = signal.sigtimedwait(TOLD, 0.02)
    if told is not None and told.si_signo == signal.SIGTERM and not is_deaf:
        break
    if told is not None and told.si_signo == signal.SIGUSR1:
        is_mute = True
    if not is_mute:
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
