"""How commands hear a live bus: channels with candump's filters, by SocketCAN or python-can."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from dbw.failures import UserMistake

if TYPE_CHECKING:
    from canbus.listener import Listener
    from telemetry.monitor.filters import Source

DEFAULT_CHANNEL: Final = "vcan0"
GATEWAY: Final = "Gateway"
LOOK_NS: Final = 300_000_000
"""For a gateway that is there already: six of its heartbeats."""


def sources_of(buses: Sequence[str]) -> list[Source]:
    """Channels and their filters, as the command line has them.

    Raises:
        UserMistake, FilterError: They cannot be used.
    """
    from telemetry.monitor.filters import Source

    sources = [Source.parse(text) for text in buses]
    if len({source.channel for source in sources}) != len(sources):
        raise UserMistake("a channel is named twice: name it once, with all its filters")
    return sources


def channels_of(sources: Sequence[Source]) -> list[str]:
    """The channels to listen to."""
    return [source.channel for source in sources] or [DEFAULT_CHANNEL]


def listener_of(
    interface: str, sources: Sequence[Source], bitrate_bps: int | None
) -> Listener:
    """What hears the channels that were asked for."""
    from canbus.interface_errors import SOCKETCAN
    from canbus.listener import PythonCanListener, SocketcanListener
    from runtime.clock import monotonic_ns, realtime_ns

    channels = channels_of(sources)
    if interface == SOCKETCAN:
        classes = [source.error_classes for source in sources]
        return SocketcanListener(channels, realtime=realtime_ns, error_classes=classes)
    return PythonCanListener(
        interface, channels, clock=monotonic_ns, realtime=realtime_ns, bitrate=bitrate_bps
    )


def gateway_is_heard(listener: Listener) -> bool:
    """Whether somebody on the bus sends what only a gateway may send.

    Args:
        listener: Not open yet.
    """
    from dbc.messages import SPECS
    from runtime.clock import monotonic_ns

    deadline_ns = monotonic_ns() + LOOK_NS
    with listener:
        while (rest_ns := deadline_ns - monotonic_ns()) > 0:
            specs = (SPECS.get(heard.word) for heard in listener.hear(rest_ns))
            if any(spec is not None and spec.sender == GATEWAY for spec in specs):
                return True
    return False
