"""Values put over others for a while, by several at once: the newest is in force."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Undo = Callable[[int], None]
"""Takes something away again, at a true time."""


class Overlays:
    """Faults overlap and end in any order; when the last has ended, what was there is back."""

    def __init__(self) -> None:
        self._layers: dict[tuple[int, str], list[list[Any]]] = {}

    def put(self, owner: Any, name: str, value: Any) -> Undo:
        """Sets an attribute until the answer is called."""
        layers = self._layers.setdefault((id(owner), name), [[getattr(owner, name)]])
        layer = [value]
        layers.append(layer)
        setattr(owner, name, value)

        def undo(true_ns: int) -> None:
            position = next(n for n, other in enumerate(layers) if other is layer)
            del layers[position]
            setattr(owner, name, layers[-1][0])
            if len(layers) == 1:
                del self._layers[id(owner), name]

        return undo
