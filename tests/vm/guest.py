"""Runs in the machine: looks around, notes what it finds in a folder of the host, ends with 37.

`guest.py FOLDER ARGUMENT ...`; `guest.py flood` only writes.
Standard output and error get bytes that text would not survive.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import can

CODE = 37
STDOUT = bytes(range(256)) * 4096
STDERR = b"\r\n\0\xff no text \x1b[0m"
VANISHES = (Path(__file__).with_name("vanishes.tmp"), Path("/etc/vanishes.tmp"))


def exchanged(sender: str, receiver: str) -> str:
    """What arrives on a network when a frame is sent on another, as `identifier#data`."""
    with (
        can.Bus(interface="socketcan", channel=receiver) as to,
        can.Bus(interface="socketcan", channel=sender) as by,
    ):
        by.send(can.Message(arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False))
        message = to.recv(10.0)
    return f"{message.arbitration_id:X}#{message.data.hex()}" if message else "nothing"


def dumped(sender: str, receiver: str) -> str:
    """The same with can-utils."""
    command = ["candump", "-n", "1", "-T", "60000", "-L", receiver]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as dump:
        # candump does not tell when it listens: the kernel's list of receivers does.
        while not is_listened_to(receiver):
            pass
        subprocess.run(["cansend", sender, "123#0102"], check=True)
        return dump.communicate()[0].split()[-1]


def is_listened_to(name: str) -> bool:
    """Whether somebody receives everything from a network."""
    lines = Path("/proc/net/can/rcvlist_all").read_text().splitlines()
    return any(line.split()[:1] == [name] for line in lines)


def main(folder: Path, arguments: list[str]) -> int:
    """The exit code."""
    for path in VANISHES:
        path.write_text("written in the machine", encoding="utf-8")
    found = {
        "arguments": [argument.encode(errors="surrogateescape").hex() for argument in arguments],
        "folder": os.getcwd(),
        "odd": os.environ.get("BASH_FUNC_ODD%%"),
        "did_write": [path.exists() for path in VANISHES],
        "vcan0": exchanged("vcan0", "vcan0"),
        "can0 to can1": exchanged("can0", "can1"),
        "can1 to can0": exchanged("can1", "can0"),
        "can0 to can1 by can-utils": dumped("can0", "can1"),
    }
    (folder / "found.json").write_text(json.dumps(found), encoding="utf-8")
    sys.stdout.buffer.write(STDOUT)
    sys.stderr.buffer.write(STDERR)
    return CODE


if __name__ == "__main__":
    if sys.argv[1:] == ["flood"]:
        sys.exit(sys.stdout.buffer.write(STDOUT) < 0)
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
