"""Debian's Chromium without a screen. Installed when it is missing and we may; else tests skip."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright

PACKAGE = "chromium"
WAIT_MS_MAX = 60_000
"""For a condition: far longer than a busy machine takes."""
LAUNCH_MS_MAX = 3 * WAIT_MS_MAX
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip


def find_chromium() -> str:
    """Its program; installed by root, on Debian. Skips the test elsewhere."""
    found = shutil.which(PACKAGE)
    if found is None and os.geteuid() == 0 and shutil.which("apt-get"):
        quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        for command in (["update"], ["install", "-y", "--no-install-recommends", PACKAGE]):
            subprocess.run(
                ["apt-get", "-qq", *command], env=quiet, check=False, capture_output=True
            )
        found = shutil.which(PACKAGE)
    if found is None:
        pytest.skip("no chromium: on Debian, as root: apt-get install chromium")
    return found


@contextmanager
def headless_chromium(folder: Path) -> Iterator[Browser]:
    """A browser with a user of its own, which gives way to a car with a 10 ms cycle."""
    gentle = folder / "gentle-chromium"
    gentle.write_text(f'#!/bin/sh\nexec nice -n 15 "{find_chromium()}" "$@"\n')
    gentle.chmod(0o755)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=gentle, args=list(FLAGS), timeout=LAUNCH_MS_MAX
        )
        try:
            yield browser
        finally:
            browser.close()
