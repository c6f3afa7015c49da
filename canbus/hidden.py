"""Imports a library as if another one were not installed.

python-can imports asammdf wherever it finds it, for a file format that nobody has asked for: 0.7 s
and 83 MiB on every start. Who imports python-can, or what imports it, hides asammdf meanwhile.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Final, cast

ASAMMDF: Final = "asammdf"


@contextmanager
def hidden(name: str) -> Iterator[None]:
    """While it lasts, `import name` fails as if it were not there; one already imported stays."""
    if name in sys.modules:
        yield
        return
    sys.modules[name] = cast("ModuleType", None)
    try:
        yield
    finally:
        del sys.modules[name]
