"""Where SocketCAN is: does parts of the measure and writes their results to standard output."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from bench.socketcan.cost import measure_cost
from bench.socketcan.echo import measure_echo
from bench.socketcan.flood import measure_flood
from bench.socketcan.load import measure_load

CALL = "from bench.socketcan.guest import main; main()"
"""For `python -c`: multiprocessing imports a main module again in every process, but not this."""

PARTS: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {"echo": measure_echo, "flood": measure_flood, "cost": measure_cost, "load": measure_load}
)

Measured = dict[str, Any]
"""Results by part."""


def main() -> None:
    """`PART... [--quick]`: the results, pickled."""
    quick = "--quick" in sys.argv
    measured: Measured = {}
    for name in sys.argv[1:]:
        if name in PARTS:
            sys.stderr.write(f"{name} ...\n")
            measured[name] = PARTS[name](quick=quick)
    sys.stdout.buffer.write(pickle.dumps(measured))
