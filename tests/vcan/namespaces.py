"""Each process in a network namespace of its own, plugged into the buses as a unit into a loom.

A namespace's vcan0 and vcan1 are the far ends of vxcan pairs, and the kernel's own gateway (cangw)
joins the near ends to the real vcan0 and vcan1. Both ends of a pair have the same index: the
gateway does not send a frame back to where it came from, and knows that by the sender's index
alone, in whatever namespace. With other indices each node would hear itself, and take itself for
a stranger.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Self

from tests.vcan.shell import run

CLONE_NEWNET = 0x40000000
INDEX_MIN = 100
"""Above those of all other networks."""


class Namespaces:
    """Makes them; `with` plugs all of them in, and leaves none behind.

    Args:
        names: one namespace each.
        buses: networks that every namespace has, the vehicle bus first.
    """

    def __init__(self, names: Sequence[str], buses: Sequence[str]) -> None:
        self._names = tuple(names)
        self._buses = tuple(buses)

    def __enter__(self) -> Self:
        for name in self._names:
            run(f"ip netns add {name}")
            for bus in self._buses:
                self._plug(name, bus)
        return self

    def __exit__(self, *exception: object) -> None:
        for name in self._names:
            for bus in self._buses:
                run(f"ip link del {self._near_end(name, bus)}")
            run(f"ip netns del {name}")

    def cut(self, name: str) -> None:
        """The cable to the vehicle bus is cut: the unit's controller is still there."""
        run(f"ip link set {self._near_end(name, self._buses[0])} down")

    def mend(self, name: str) -> None:
        """The cable is whole again."""
        run(f"ip link set {self._near_end(name, self._buses[0])} up")

    def pull_out(self, name: str) -> None:
        """The unit's controller is gone, as a USB adapter that is pulled out."""
        run(f"ip link del {self._near_end(name, self._buses[0])}")

    def put_in(self, name: str) -> None:
        """Another controller, of the same name."""
        self._plug(name, self._buses[0])

    def _index(self, name: str, bus: str) -> int:
        return INDEX_MIN + self._names.index(name) * len(self._buses) + self._buses.index(bus)

    def _near_end(self, name: str, bus: str) -> str:
        return f"vx{self._index(name, bus)}"

    def _plug(self, name: str, bus: str) -> None:
        near, index = self._near_end(name, bus), self._index(name, bus)
        peer = f"name {bus} index {index} netns {name}"
        run(f"ip link add {near} index {index} type vxcan peer {peer}")
        run(f"ip link set {near} up")
        run(f"ip -n {name} link set {bus} up")
        run(f"cangw -A -s {near} -d {bus} -e")
        run(f"cangw -A -s {bus} -d {near}")


def enter(name: str) -> None:
    """This process lives in that namespace from now on."""
    with open(f"/run/netns/{name}") as file:
        if ctypes.CDLL(None, use_errno=True).setns(file.fileno(), CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), f"cannot enter the namespace {name}")
