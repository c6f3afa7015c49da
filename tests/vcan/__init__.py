"""Integration tests on real SocketCAN, with a process per node."""

import os

VARIABLE = "CAN_BY_WIRE_VCAN"
"""Set where the suite is to run: on a host with vcan0 and vcan1, or in the virtual machine.
Names the folder for what is measured."""

LOAD_VARIABLE = f"{VARIABLE}_LOAD_S_MAX"
LOAD_S_MAX = float(os.environ.get(LOAD_VARIABLE, "120"))
"""For what waits until Python has come from the disk. In a machine the clock races meanwhile: on a
busy host one more Python took over 900 s. What hangs with nothing to do comes there at once."""
