"""What the host must have: programs of Debian packages, installed or asked for."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

PACKAGE_OF_PROGRAM = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "depmod": "kmod",
    "modprobe": "kmod",
    "ip": "iproute2",
    "candump": "can-utils",
    "cangw": "can-utils",
}
"""Programs used on the host or, from the host's file system, in the guest."""

SYSTEM_PATHS = ("/usr/local/sbin", "/usr/local/bin", "/usr/sbin", "/usr/bin", "/sbin", "/bin")
"""Administrators' programs are not on every user's path."""

APT = ["apt-get", "-o", "DPkg::Lock::Timeout=300"]
"""Waits for an apt that is at work already."""

Say = Callable[[str], None]


class VmError(Exception):
    """The machine cannot be had, or has failed; one line for the user."""


def program(name: str) -> str:
    """Path of a program of the host.

    Raises:
        VmError: it is not installed.
    """
    path = _find(name)
    if path is None:
        raise VmError(f"{name} is missing: {_how_to_install([PACKAGE_OF_PROGRAM[name]])}")
    return path


def missing_packages() -> list[str]:
    """Debian packages whose programs are not there."""
    missing = {
        package for name, package in PACKAGE_OF_PROGRAM.items() if _find(name) is None
    }
    busybox = _find("busybox")
    if busybox is not None and not is_static(Path(busybox)):
        missing.add("busybox-static")
    return sorted(missing)


def install(packages: Sequence[str], say: Say) -> None:
    """Installs Debian packages, as root or by a sudo that asks nothing.

    Raises:
        VmError: no Debian, no right to, or apt-get failed; says what to type.
    """
    if not packages:
        return
    how = _how_to_install(packages)
    if not is_debian():
        raise VmError(f"{', '.join(packages)} missing, and this is no Debian: install them first")
    root = _root_prefix()
    if root is None:
        raise VmError(f"{', '.join(packages)} missing: {how}")
    say(f"installing {' '.join(packages)}")
    command = [*root, "env", "DEBIAN_FRONTEND=noninteractive", *APT, "install", "-y",
               "--no-install-recommends", *packages]
    if not _succeeds(command):
        _succeeds([*root, *APT, "update"])  # a fresh machine has no lists, or old ones
        if not _succeeds(command):
            raise VmError(f"apt-get could not install {' '.join(packages)}; try: {how}")


def download(package: str, folder: Path) -> Path:
    """Fetches a package's file without installing it.

    Raises:
        VmError: apt-get cannot get it.
    """
    command = [*APT, "download", package]
    if not _succeeds(command, folder):
        root = _root_prefix()
        if root is not None:
            _succeeds([*root, *APT, "update"])
        if root is None or not _succeeds(command, folder):
            raise VmError(f"cannot download {package}: try 'sudo apt-get update' first")
    return next(folder.glob(f"{package}_*.deb"))


def newest_kernel_package() -> str:
    """The package that Debian's `linux-image-amd64` stands for.

    Raises:
        VmError: this is no Debian, or apt does not know it.
    """
    if not is_debian():
        raise VmError("this is no Debian: the virtual machine's kernel comes from its packages")
    for is_last in (False, True):
        answer = subprocess.run(
            ["apt-cache", "depends", "linux-image-amd64"],
            capture_output=True, text=True, check=False, env={**os.environ, "LC_ALL": "C"},
        )
        for line in answer.stdout.splitlines():
            kind, _, name = line.strip().partition(": ")
            if kind == "Depends" and name.startswith("linux-image-"):
                return name
        root = _root_prefix()
        if root is not None and not is_last:
            _succeeds([*root, *APT, "update"])
    raise VmError("apt knows no linux-image-amd64: try 'sudo apt-get update' first")


def is_debian() -> bool:
    """Whether packages come by apt."""
    return all(_find(name) is not None for name in ("apt-get", "apt-cache", "dpkg-deb"))


def is_static(path: Path) -> bool:
    """Whether an ELF program needs no dynamic loader."""
    return b"/ld-linux" not in path.read_bytes()[:4096]


def _find(name: str) -> str | None:
    return shutil.which(name) or shutil.which(name, path=os.pathsep.join(SYSTEM_PATHS))


def _how_to_install(packages: Sequence[str]) -> str:
    return f"sudo apt-get install {' '.join(packages)}"


def _root_prefix() -> list[str] | None:
    """What to put before a command for it to run as root; None when that needs a password."""
    if os.geteuid() == 0:
        return []
    sudo = _find("sudo")
    if sudo is not None and _succeeds([sudo, "-n", "true"]):
        return [sudo, "-n"]
    return None


def _succeeds(command: Sequence[str], folder: Path | None = None) -> bool:
    result = subprocess.run(command, cwd=folder, stdin=subprocess.DEVNULL,
                            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
    return result.returncode == 0
