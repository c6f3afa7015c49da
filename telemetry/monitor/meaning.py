"""What a frame means: its message and signals, CANopen's words, or the words of an error frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from canbus.frame import CAN_ID_MAX
from canbus.heard import REMOTE_FLAG, Heard
from telemetry.monitor.canopen_words import NO_DRIVES, PDO_IDS, CanopenWords
from telemetry.monitor.error_words import error_words
from telemetry.monitor.known import NO_CONTENT, Catalogue, Content, Known

CANOPEN_FUNCTION: Final = 0x780


@dataclass(frozen=True, slots=True)
class Meaning:
    """Of one frame.

    Attributes:
        title: Message name, or what kind of frame it is; empty for an unknown frame.
        words: What it says, in words; empty if the signals tell it.
        content: Its signals.
        is_bad: Whether something is wrong with it: an error frame, or one that cannot be read.
    """

    title: str = ""
    words: str = ""
    content: Content = NO_CONTENT
    is_bad: bool = False


class Interpreter:
    """Finds the meaning of frames.

    Args:
        catalogue: The messages that are known.
        canopen: Whether the bus is a CANopen network (the predefined connection set); None for
            one that carries this project's messages.
        drives: Names of the car's motor drives, by node id.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        *,
        canopen: bool | None = None,
        drives: Mapping[int, str] = NO_DRIVES,
    ) -> None:
        self.catalogue = catalogue
        is_canopen = catalogue.has_own if canopen is None else canopen
        self._canopen = (
            CanopenWords(is_own=catalogue.has_own, drives=drives) if is_canopen else None
        )

    def known(self, heard: Heard) -> Known | None:
        """The message of a frame, remote or not; None for an unknown one and for errors."""
        if heard.is_error:
            return None
        return self.catalogue.find(heard.channel, heard.word & ~REMOTE_FLAG)

    def meaning(self, heard: Heard, known: Known | None) -> Meaning:
        """What a frame says, `known` being its message."""
        if heard.is_error:
            return Meaning("ERRORFRAME", error_words(heard.can_id, heard.data), is_bad=True)
        title = "" if known is None else known.name
        if heard.is_remote:
            return Meaning(title, f"asks for {heard.length} bytes" if title else "")
        words = self._canopen_words(heard, known)
        if words is not None:
            return Meaning(title, words, is_bad=words.endswith("malformed"))
        if known is None:
            return Meaning()
        content = known.read(heard.data)
        return Meaning(title, content=content, is_bad=bool(content.fault))

    def _canopen_words(self, heard: Heard, known: Known | None) -> str | None:
        """None where the signals tell more, or the identifier is another message's."""
        if self._canopen is None or heard.word > CAN_ID_MAX or heard.is_fd:
            return None
        if known is not None and not known.is_own:
            return None
        is_pdo = heard.word & CANOPEN_FUNCTION in PDO_IDS
        return None if is_pdo and known is not None else self._canopen.say(heard.word, heard.data)
