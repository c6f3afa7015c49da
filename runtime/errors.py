"""What the user of the runtime may have done wrong."""

from __future__ import annotations


class LaunchError(RuntimeError):
    """A stack that cannot be started, stopped or found. One line: what is wrong, what to do."""
