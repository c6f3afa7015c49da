"""Settings of all tests: random examples are the same in every run and on every machine."""

from __future__ import annotations

from hypothesis import settings

# No deadline per example: how long one takes is the machine's affair, loaded or traced.
settings.register_profile("project", deadline=None, derandomize=True)
settings.load_profile("project")
