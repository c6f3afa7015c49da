"""What a person wants to see: by candump's filters, and by names of messages, signals, nodes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from canbus.heard import ANY, Heard
from telemetry.monitor.filters import FilterError, Source
from telemetry.monitor.known import Catalogue, Known


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """A frame is shown if its channel's filters pass it and, where names are given, one fits.

    Attributes:
        sources: Channels and their filters; without any, every channel.
        names: Messages by name; empty for all.
        signals: Names of the only signals to show; empty for all.
        by_name: Whether names were given: unknown frames are then left out.
    """

    sources: tuple[Source, ...] = ()
    names: frozenset[str] = frozenset()
    signals: frozenset[str] = frozenset()
    by_name: bool = False
    _by_channel: dict[str, Source] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Sorts the sources by channel."""
        self._by_channel.update({source.channel: source for source in self.sources})

    def passes(self, heard: Heard, known: Known | None) -> bool:
        """Whether a frame is wanted, `known` being its message."""
        return self.wants(heard.channel, heard.word, known)

    def wants(self, channel: str, word: int, known: Known | None) -> bool:
        """The same by channel and identifier with its flags."""
        if self.sources:
            source = self._by_channel.get(channel) or self._by_channel.get(ANY)
            if source is None or not source.passes(word):
                return False
        return not self.by_name or (known is not None and known.name in self.names)


def select(
    catalogue: Catalogue,
    sources: Sequence[Source] = (),
    *,
    messages: Iterable[str] = (),
    signals: Iterable[str] = (),
    nodes: Iterable[str] = (),
) -> Selection:
    """The selection by names, which add up: a frame is wanted if any of them fits.

    Args:
        catalogue: The messages that are known.
        sources: Channels and their filters.
        messages: Names of messages; capitals and underscores do not count (`SteerStatus`).
        signals: Names of signals, or `MESSAGE.SIGNAL`.
        nodes: Names of senders.

    Raises:
        FilterError: A name is not known; the nearest ones are told.
    """
    known = list(catalogue.messages.values())
    names = {_nearest("message", name, catalogue.names()) for name in messages}
    only: set[str] = set()
    for given in signals:
        owner, _, name = given.rpartition(".")
        carriers = known
        if owner:
            owner = _nearest("message", owner, catalogue.names())
            carriers = [message for message in known if message.name == owner]
        name = _nearest("signal", name, {n for message in carriers for n in message.signals})
        only.add(name)
        names |= {message.name for message in carriers if name in message.signals}
    for given in nodes:
        node = _nearest("node", given, catalogue.nodes())
        names |= {message.name for message in known if message.sender == node}
    return Selection(
        sources=tuple(sources),
        names=frozenset(names),
        signals=frozenset(only),
        by_name=bool(names),
    )


def _plain(name: str) -> str:
    return name.replace("_", "").lower()


def _nearest(what: str, name: str, names: Iterable[str]) -> str:
    """The known name that is meant."""
    by_plain = {_plain(known): known for known in sorted(names, reverse=True)}
    found = by_plain.get(_plain(name))
    if found is not None:
        return found
    import difflib  # only mistyped names need it

    close = difflib.get_close_matches(_plain(name), by_plain, n=3, cutoff=0.5)
    if close:
        raise FilterError(f"no {what} {name!r}: nearest {', '.join(by_plain[c] for c in close)}")
    known = sorted(by_plain.values())
    shown = ", ".join(known[:12]) + f" and {len(known) - 12} more" * (len(known) > 12)
    raise FilterError(f"no {what} {name!r}: known are {shown or 'none'}")
