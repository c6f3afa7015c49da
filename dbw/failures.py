"""Exit codes, and which exceptions are a user's mistake and which the stack's failure."""

from __future__ import annotations

import sys

EXIT_OK = 0
EXIT_FAILED = 1
"""The drive or the stack failed."""
EXIT_USER = 2
"""The user's mistake: nothing was sent, nothing written."""
EXIT_INTERRUPTED = 130
"""Ctrl-C, as shells have it."""


class UserMistake(Exception):
    """An option or a file that cannot be used; one line that says what is allowed."""


def one_line(text: object) -> str:
    """The text without line breaks."""
    return " ".join(str(text).split())


def complain(text: object) -> None:
    """One line on stderr."""
    sys.stderr.write(f"dbw: error: {one_line(text)}\n")
    sys.stderr.flush()


def is_user_mistake(error: Exception) -> bool:
    """Whether an exception of the libraries below says what a user did wrong.

    The modules are looked for among those already imported: what was never imported cannot have
    raised anything, and importing it now would cost a second.
    """
    names = (
        ("vehicles.vehicle", "VehicleError"),
        ("planner.road", "RoadError"),
        ("gateway.commands", "CommandError"),
        ("canbus.bus", "BusError"),
        ("runtime.errors", "LaunchError"),
        ("runtime.vm.host", "VmError"),
        ("telemetry.databases", "DatabaseError"),
        ("telemetry.folder", "FolderError"),
        ("telemetry.monitor.filters", "FilterError"),
        ("telemetry.dashboard.server", "DashboardError"),
        ("telemetry.replay.through_node", "ReplayError"),
        ("telemetry.logs.formats", "LogError"),
        ("telemetry.record.formats", "FormatError"),
        ("telemetry.record.recorder", "RecordingError"),
        ("telemetry.steering_zero", "CalibrationError"),
        ("telemetry.why.freeze", "FreezeError"),
        ("simulation.faults", "FaultError"),
        ("campaign.store", "StoreError"),
        ("campaign.workers", "WorkersError"),
    )
    kinds = tuple(
        getattr(sys.modules[module], name) for module, name in names if module in sys.modules
    )
    return isinstance(error, (UserMistake, *kinds))
