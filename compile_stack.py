"""Compiles the stack's hot modules with mypyc, for long simulations: `make compiled`.

The packages are copied to `build/compiled` and compiled there, so that no compiled module ever
hides an edited source. What runs from there behaves as the source does, frame by frame: a test
compares the traces.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent
PACKAGES = ("campaign", "canbus", "dbc", "dbw", "ecus", "gateway", "oracle", "planner",
            "safety_monitor", "simulation", "telemetry", "vehicles")
"""Copied: what is compiled, and what it imports by name."""

COMPILED = (
    "canbus/*.py", "dbc/*.py", "ecus/**/*.py", "gateway/*.py", "safety_monitor/*.py",
    "oracle/*.py", "simulation/**/*.py", "telemetry/bus_log.py",
    "campaign/route.py", "campaign/pilot.py", "campaign/expectation.py", "campaign/ledger.py",
    "planner/pose.py", "planner/gnss.py", "planner/tracker.py", "planner/localisation.py",
    "planner/pure_pursuit.py", "dbw/drive.py", "dbw/virtual_stage.py",
)
INTERPRETED = frozenset({
    "canbus/bus.py", "canbus/python_can_bus.py",  # wall time only
    "canbus/canopen_device.py",  # subclasses an untyped library's classes
    "canbus/canopen_node.py", "simulation/drives/device.py",  # and classes of that
    "dbc/database.py", "dbc/generate.py",  # not in the loop
    "dbc/harness.py", "dbc/byte_commands.py",  # nor these
    "gateway/api.py",  # an asynchronous generator: mypyc has none
    "gateway/connect.py", "gateway/procedures.py", "gateway/errors.py", "gateway/node_health.py",
    "gateway/sentences.py",
})

SETUP = """
from mypyc.build import mypycify
from setuptools import setup
setup(name="compiled", packages=[], ext_modules=mypycify({arguments!r}, opt_level="3"))
"""


def modules(root: Path) -> Iterator[str]:
    """Modules to compile, relative to the root."""
    for pattern in COMPILED:
        for path in sorted(root.glob(pattern)):
            name = path.relative_to(root).as_posix()
            if path.name != "__init__.py" and name not in INTERPRETED:
                yield name


def compile_into(target: Path) -> None:
    """Copies and compiles; takes minutes and a C compiler.

    Raises:
        subprocess.CalledProcessError: mypyc or the C compiler failed; its text is in `stdout`.
    """
    shutil.rmtree(target, ignore_errors=True)
    for package in PACKAGES:
        shutil.copytree(ROOT / package, target / package,
                        ignore=shutil.ignore_patterns("__pycache__"))
    arguments = ["--ignore-missing-imports", *modules(target)]
    (target / "setup.py").write_text(SETUP.format(arguments=arguments), encoding="utf-8")
    subprocess.run(
        [sys.executable, "setup.py", "--quiet", "build_ext", "--inplace"],
        cwd=target, check=True, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )
    shutil.rmtree(target / "build")


if __name__ == "__main__":
    if shutil.which("cc") is None:
        sys.exit("a C compiler is needed, on Debian: apt install gcc python3-dev")
    try:
        compile_into(ROOT / "build/compiled")
    except subprocess.CalledProcessError as error:
        sys.exit(error.stdout)
