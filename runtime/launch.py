"""Starting, watching and stopping a whole stack.

`InProcessStack` holds everything in threads of this process; `ProcessStack` starts one process per
node. `stop` and `status` reach the latter from any other process.
"""

from __future__ import annotations

from runtime.errors import LaunchError
from runtime.in_process import InProcessStack
from runtime.process_stack import ProcessStack, StackSettings
from runtime.stack_control import StopResult, status, stop
from runtime.state_file import ProcessRecord, StackState, known_channels

__all__ = [
    "InProcessStack",
    "LaunchError",
    "ProcessRecord",
    "ProcessStack",
    "StackSettings",
    "StackState",
    "StopResult",
    "known_channels",
    "status",
    "stop",
]
