"""What every property is: a name, a sentence, and what it looks at."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from oracle.decode import Message
from oracle.sample import Sample
from oracle.scene import Fault, Scene
from oracle.settings import Settings

Complain = Callable[[str, int, str], None]
"""`(property, true_ns, text)`: a violation."""


class Property:
    """A sentence about the world that a history can break; the docstring of each gives it.

    A property sees the scene as it is after what it is told. It keeps what it needs of the past.
    """

    name: ClassVar[str]
    watches: ClassVar[tuple[str, ...]] = ()
    """Names of the messages whose frames `on_message` wants."""

    def __init__(self, scene: Scene, settings: Settings, complain: Complain) -> None:
        self.scene = scene
        self.settings = settings
        self._complain = complain

    def violated(self, now_ns: int, text: str) -> None:
        """The history breaks the property now."""
        self._complain(self.name, now_ns, text)

    def on_message(self, now_ns: int, message: Message) -> None:
        """A frame of one of the messages that are watched, if it brings anything new.

        One that repeats the content of the frame before it does not; `scene.channels` knows when
        it came all the same.
        """

    def on_sample(self, now_ns: int, sample: Sample) -> None:
        """A look at the truth."""

    def on_fault(self, now_ns: int, fault: Fault, *, is_begin: bool) -> None:
        """Something breaks, or is whole again."""


class Once:
    """True at the beginning of every episode: a state that lasts is one violation."""

    __slots__ = ("_is_on",)

    def __init__(self) -> None:
        self._is_on = False

    def begins(self, is_on: bool) -> bool:
        """Whether the episode begins with this instant."""
        was_on, self._is_on = self._is_on, is_on
        return is_on and not was_on


def ms(span_ns: int) -> str:
    """A span as words."""
    return f"{span_ns / 1e6:.1f} ms"
