"""A folder that gets all of a drive's files or none."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import Self


class FolderError(OSError):
    """The folder cannot be written; one line with path and reason."""


class ResultFolder:
    """Collects files beside their destination and moves them there at the end.

    Within `with`, write to `path`; `commit` moves everything into the destination, each file in one
    step, over a file of the same name. Other files there are left alone. Without `commit` (an
    exception, Ctrl-C) nothing remains, not even folders that were made on the way.

    Args:
        destination: Made on `commit` if it is missing.
    """

    def __init__(self, destination: Path) -> None:
        self.destination = destination
        self._made: list[Path] = []
        self._path: Path | None = None
        self._is_committed = False

    @property
    def path(self) -> Path:
        """Where to write until `commit`."""
        assert self._path is not None, "only within `with`"
        return self._path

    def __enter__(self) -> Self:
        """Makes sure that writing will be possible later.

        Raises:
            FolderError: It will not.
        """
        if self.destination.exists() and not self.destination.is_dir():
            raise FolderError(f"{self.destination} is a file: a folder is wanted")
        try:
            parent = self._existing_parent()
            if self.destination.is_dir():
                parent = self.destination  # it is that one which has to be writable
            self._path = Path(tempfile.mkdtemp(prefix=".unfinished-", dir=parent))
        except OSError as error:
            self._clean()
            reason = error.strerror or str(error)
            raise FolderError(f"{self.destination} cannot be written: {reason}") from error
        return self

    def _existing_parent(self) -> Path:
        """The destination's parent, made if it is missing."""
        parent = self.destination.absolute().parent
        missing = [folder for folder in (parent, *parent.parents) if not folder.exists()]
        for folder in reversed(missing):
            folder.mkdir()
            self._made.append(folder)
        return parent

    def commit(self) -> list[Path]:
        """Moves the files to the destination.

        Returns:
            Where they are now, by name.

        Raises:
            FolderError: They cannot be moved.
        """
        names = sorted(item.name for item in self.path.iterdir())
        try:
            os.chmod(self.path, 0o777 & ~_umask())  # mkdtemp's 0700 is for secrets
            if self.destination.exists():
                for name in names:
                    os.replace(self.path / name, self.destination / name)
            else:
                os.rename(self.path, self.destination)
        except OSError as error:
            reason = error.strerror or str(error)
            raise FolderError(f"{self.destination} cannot be written: {reason}") from error
        self._is_committed = True
        return [self.destination / name for name in names]

    def __exit__(self, *exception: object) -> None:
        """Removes what has not been committed."""
        self._clean()

    def _clean(self) -> None:
        if self._path is not None:
            shutil.rmtree(self._path, ignore_errors=True)
        if not self._is_committed:
            for folder in reversed(self._made):
                try:
                    folder.rmdir()
                except OSError:
                    return  # somebody else uses it by now


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
