"""What may go wrong for a planner that is no mistake in a value. Each text is one line."""

from __future__ import annotations


class NotConnected(RuntimeError):
    """A call outside the `with` block, before it or after it."""


class LinkFailed(RuntimeError):
    """The connection to the car broke; the exception that ended it is the cause."""


class EngageRefused(RuntimeError):
    """The car did not become AUTOMATIC in time; the text says why."""


class DisengageFailed(RuntimeError):
    """The car did not come to READY or MANUAL: an emergency brake came first, or no answer."""


class ResetRefused(RuntimeError):
    """The supervisor did not reset in time; the text says why."""
