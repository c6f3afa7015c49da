"""Kernel and first file system of the machine, made once into a cache folder."""

from __future__ import annotations

import gzip
import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from runtime.vm import host
from runtime.vm.host import VmError, program

CACHE_VARIABLE = "CAN_BY_WIRE_CACHE"
"""Environment variable that puts the cache elsewhere."""

MODULES = (
    "virtio_pci", "virtio_console", "9pnet_virtio", "9p", "overlay",
    "can", "can-raw", "can-bcm", "can-gw", "can-dev", "vcan", "vxcan", "sja1000", "kvaser_pci",
    "sch_tbf",
)
"""Kernel modules: the machine's own devices, then all kinds of CAN, and a slow queue."""

STEPS = 5
"""Reports that `prepare` gives, the last one when it is done."""

Report = Callable[[int, str], None]
"""`(step, what is done now)`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Image:
    """What the machine boots.

    Attributes:
        kernel: compressed Linux.
        initramfs: the first file system, with the modules and `init.sh`.
    """

    kernel: Path
    initramfs: Path


def cache_folder() -> Path:
    """Where images are kept, one folder per recipe."""
    given = os.environ.get(CACHE_VARIABLE)
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(given) if given else base / "can-by-wire"


def recipe() -> str:
    """A name for what goes into an image: another recipe, another image."""
    text = " ".join(MODULES) + init_script() + Path(__file__).read_text(encoding="utf-8")
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def init_script() -> str:
    """The guest's first program."""
    return files("runtime.vm").joinpath("init.sh").read_text(encoding="utf-8")


def prepare(report: Report = lambda step, text: None) -> Image:
    """The image, from the cache or made now; safe to be called by several at once.

    Raises:
        VmError: something is missing on the host that cannot be installed, or the cache folder
            cannot be written to.
    """
    missing = host.missing_packages()
    host.install(missing, lambda text: report(0, text))
    folder = cache_folder() / f"vm-{recipe()}"
    image = Image(kernel=folder / "vmlinuz", initramfs=folder / "initramfs.gz")
    if not folder.exists():
        try:
            _make_into(folder, report)
        except OSError as error:
            raise VmError(f"cannot write to the cache ({CACHE_VARIABLE}): {error}") from error
        report(STEPS, "ready")
    return image


def _make_into(folder: Path, report: Report) -> None:
    """Makes the image aside and moves it into place whole, if nobody else was faster."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="vm-new-", dir=folder.parent) as scratch:
        made = _make(Path(scratch), report)
        try:
            made.rename(folder)
        except OSError:
            if not folder.exists():
                raise


def _make(scratch: Path, report: Report) -> Path:
    """Makes kernel and initramfs in a folder of their own within the scratch folder."""
    made, unpacked, root = scratch / "made", scratch / "unpacked", scratch / "root"
    made.mkdir()
    report(1, "finding Debian's kernel")
    package = host.newest_kernel_package()
    report(2, f"downloading {package}")
    scratch.chmod(0o755)  # apt's own user may read it
    archive = host.download(package, scratch)
    report(3, f"unpacking {package}")
    _run(["dpkg-deb", "-x", str(archive), str(unpacked)])
    version = package.removeprefix("linux-image-")
    shutil.copy(unpacked / "boot" / f"vmlinuz-{version}", made / "vmlinuz")
    report(4, "packing the modules")
    _fill(root, unpacked, version)
    _pack(root, made / "initramfs.gz")
    return made


def _fill(root: Path, unpacked: Path, version: str) -> None:
    """The first file system: busybox, the modules in the order in which they load, init."""
    (root / "modules").mkdir(parents=True)
    (root / "bin").mkdir()
    busybox = root / "bin/busybox"
    shutil.copy(program("busybox"), busybox)
    init = root / "init"
    init.write_text(init_script(), encoding="utf-8")
    init.chmod(0o755)
    names = []
    for number, module in enumerate(_load_order(unpacked, version)):
        name = f"{number:02}-{module.name}"
        shutil.copy(module, root / "modules" / name)
        names.append(name)
    assert names, "the kernel has CAN built in"


def _load_order(unpacked: Path, version: str) -> list[Path]:
    """Module files, each after those it needs."""
    libraries = unpacked / "lib" / "modules" / version
    _run([program("depmod"), "-b", str(unpacked), version])
    ordered: list[Path] = []
    for name in MODULES:
        text = _run([program("modprobe"), "-d", str(unpacked), "-S", version, "-D", name])
        for line in text.splitlines():
            kind, _, path = line.strip().partition(" ")
            if kind == "insmod":
                module = Path(path.split()[0])
                if module not in ordered:
                    ordered.append(module)
    assert all(libraries in module.parents for module in ordered)
    return ordered


def _pack(root: Path, target: Path) -> None:
    """An initramfs: cpio in the `newc` format, compressed."""
    names = sorted(path.relative_to(root).as_posix() for path in root.rglob("*"))
    archive = subprocess.run(
        [program("busybox"), "cpio", "-o", "-H", "newc"],
        cwd=root, input="\n".join(names).encode() + b"\n", capture_output=True, check=False,
    )
    if archive.returncode:
        raise VmError(f"cannot pack the initramfs: {archive.stderr.decode(errors='replace')}")
    target.write_bytes(gzip.compress(archive.stdout, 1))


def _run(command: list[str]) -> str:
    try:
        result = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise VmError(f"cannot run {command[0]}: {error}") from error
    if result.returncode:
        raise VmError(f"{' '.join(command[:2])} failed: {result.stderr.strip()[-300:]}")
    return result.stdout
