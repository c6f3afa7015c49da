"""The suite needs SocketCAN: `python -m tests.vcan` runs it here, or in the virtual machine."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from tests.vcan import VARIABLE
from tests.vcan.stack import Stack

collect_ignore_glob = [] if os.environ.get(VARIABLE) else ["test_*.py"]


@pytest.fixture(scope="module")
def module_stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """One stack for all tests of a file: starting seven processes is what takes time."""
    with Stack(tmp_path_factory.mktemp("stack")) as stack:
        yield stack


@pytest.fixture
def parked(module_stack: Stack) -> Stack:
    """Everything runs, nothing is broken, the car stands in MANUAL."""
    module_stack.recover()
    return module_stack


@pytest.fixture
def driving(parked: Stack) -> Stack:
    """The car drives straight on at some 3 m/s."""
    parked.drive()
    return parked
