"""Stands in for the command line: `fake_dbw.py ecu NAME ...` runs until it is told to end.

Writes `NAME up` and `NAME down` into $FAKE_DBW_LOG. $FAKE_DBW_DIES names a node that ends at once,
$FAKE_DBW_DEAF one that does not listen to SIGTERM. With $FAKE_DBW_STAYS none minds the launcher's
death.
"""

import os
import signal
import sys
import threading

name = sys.argv[2]
done = threading.Event()


def say(text: str) -> None:
    with open(os.environ["FAKE_DBW_LOG"], "a") as log:
        log.write(f"{name} {text}\n")


if os.environ.get("FAKE_DBW_DIES") == name:
    sys.exit(3)
if os.environ.get("FAKE_DBW_DEAF") == name:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
else:
    signal.signal(signal.SIGTERM, lambda number, frame: done.set())
say("up " + " ".join(sys.argv[3:]))
while not done.wait(0.02):
    is_orphan = os.getppid() != int(os.environ["DBW_LAUNCHER_PID"])
    if is_orphan and "FAKE_DBW_STAYS" not in os.environ:
        say("orphan")
        sys.exit(1)
say("down")
