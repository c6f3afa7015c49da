"""Which code a result comes from."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy

PACKAGES = (
    "canbus", "dbc", "ecus", "gateway", "safety_monitor", "vehicles", "oracle", "simulation",
    "planner", "campaign",
)  # fmt: skip
"""All that a seed's result can depend on."""
SUFFIXES = frozenset({".py", ".dbc", ".eds", ".toml", ".csv"})
TELLING = frozenset({
    "cluster", "code", "explained", "failure", "fault_docs", "futures", "matrix", "minimise",
    "page", "parts", "plots", "replay", "report", "statistics", "store", "summary", "workers",
})
"""Modules of `campaign` that carry results about and change none."""


@cache
def code_sha256() -> str:
    """Of the sources and the data files of all packages, and of the version of numpy.

    A compiled stack (`compile_stack.py`) keeps its sources, and behaves alike: it has one hash
    with them.
    """
    digest = hashlib.sha256(numpy.__version__.encode())
    for package in PACKAGES:
        spec = find_spec(package)
        assert spec is not None and spec.submodule_search_locations
        root = Path(next(iter(spec.submodule_search_locations)))
        for path in sorted(root.rglob("*")):
            if path.suffix in SUFFIXES and not (package == "campaign" and path.stem in TELLING):
                digest.update(f"\0{package}/{path.relative_to(root).as_posix()}\0".encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()
