"""Integration tests on real SocketCAN, with a process per node."""

VARIABLE = "CAN_BY_WIRE_VCAN"
"""Set where the suite is to run: on a host with vcan0 and vcan1, or in the virtual machine.
Names the folder for what is measured."""
