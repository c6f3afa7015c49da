"""A progress bar with a live line, for any command that takes a while."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID
from rich.text import Text


class _LineColumn(ProgressColumn):
    """The newest line, cut at the terminal's edge."""

    def render(self, task: Task) -> Text:
        """Of one bar."""
        return Text(task.fields["line"])


class ProgressBar:
    """Shown within `with`, on terminals alone, so that a log file stays readable.

    Args:
        console: Where to.
        total: Length of the bar, in the caller's unit.
        columns: Shown between bar and line.
    """

    def __init__(self, console: Console, total: float, *columns: ProgressColumn) -> None:
        self._total = total
        self._task: TaskID | None = None
        self._progress = Progress(
            BarColumn(bar_width=14),
            *columns,
            _LineColumn(),
            console=console,
            auto_refresh=False,
            transient=True,
            disable=not console.is_terminal,
        )

    def __enter__(self) -> Self:
        """Shows an empty bar."""
        self._progress.start()
        self._task = self._progress.add_task("", total=self._total, line="starting up")
        self._progress.refresh()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Takes the bar away."""
        self._progress.stop()

    def draw(self, completed: float, line: str) -> None:
        """Shows how far it is, and a line."""
        assert self._task is not None, "only within `with`"
        self._progress.update(self._task, completed=completed, line=line)
        self._progress.refresh()
