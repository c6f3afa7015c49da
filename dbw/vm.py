"""`dbw vm`: real SocketCAN in a small virtual machine, for kernels without it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dbw.failures import EXIT_INTERRUPTED, UserMistake
from dbw.main import PlainGroup

if TYPE_CHECKING:
    from runtime.vm import Image

EXIT_MACHINE = 125
"""The machine failed, not the command in it (as `docker run` has it)."""

ACCELERATOR_VARIABLE = "CAN_BY_WIRE_VM_ACCELERATOR"
SHELL = "/bin/bash"


@click.group(
    cls=PlainGroup,
    epilog="""\b
Examples:
  dbw vm run -- candump -n 1 vcan0
  dbw vm shell"""
)
def vm() -> None:
    """Run commands where SocketCAN is: in a virtual machine with vcan0, vcan1, can0 and can1.

    The machine sees this computer's files and forgets what it writes to them. vcan0 and vcan1 are
    virtual buses; can0 and can1 are two controllers (SJA1000, 500 kbit/s) on one wire. The first
    call prepares the machine, which takes a minute and 100 MB.

    A kernel with vcan does not need it.
    """


def _options(command: Any) -> Any:
    """Options that `run` and `shell` share."""
    for option in (
        click.option("--cpus", default=2, show_default=True, metavar="N", help="Processors."),
        click.option("--memory", default=2048, show_default=True, metavar="MIB", help="Memory."),
        click.option(
            "--icount", type=int, metavar="SHIFT",
            help="Let the guest's clock count instructions, each 2^SHIFT ns: its time does not "
            "depend on this computer's load. One processor.",
        ),
        click.option(
            "--accelerator", envvar=ACCELERATOR_VARIABLE, default="tcg", show_default=True,
            metavar="tcg|kvm", help=f"Software emulation, or KVM; also by ${ACCELERATOR_VARIABLE}.",
        ),
        click.option(
            "--writable", multiple=True, metavar="DIR", type=click.Path(path_type=Path),
            help="A folder in which what the machine writes stays; may be repeated.",
        ),
    ):
        command = option(command)
    return command


@vm.command(
    epilog="""\b
Examples:
  dbw vm run -- ip -details link show can0
  dbw vm run --icount 1 --writable out -- python -m pytest tests/vcan"""
)
@_options
@click.option(
    "--timeout", default=3600.0, show_default=True, metavar="S",
    help="End the machine when the command takes longer.",
)
@click.argument("command", nargs=-1, type=click.UNPROCESSED)
def run(command: tuple[str, ...], **options: Any) -> int:
    """Run COMMAND in the machine; its output and exit code are passed through.

    125 when the machine itself failed.
    """
    if not command:
        raise UserMistake("COMMAND is missing: dbw vm run -- COMMAND [ARGUMENT ...]")
    return _run(command, is_interactive=False, **options)


@vm.command(
    epilog="""\b
Example:
  dbw vm shell"""
)
@_options
def shell(**options: Any) -> int:
    """Open a shell in the machine; leave it with `exit`."""
    if not sys.stdin.isatty():
        raise UserMistake("a shell needs a terminal; for a script: dbw vm run -- COMMAND")
    return _run((SHELL, "-i"), is_interactive=True, timeout=float("inf"), **options)


@vm.command(
    epilog="""\b
Example:
  dbw vm prepare"""
)
def prepare() -> int:
    """Prepare the machine now, as the first `run` does by itself."""
    image = _prepared()
    click.echo(f"ready in {image.kernel.parent}")
    return 0


def _run(
    command: tuple[str, ...],
    *,
    is_interactive: bool,
    cpus: int,
    memory: int,
    icount: int | None,
    accelerator: str,
    writable: tuple[Path, ...],
    timeout: float,
) -> int:
    from runtime.stopping import StopRequest
    from runtime.vm import Machine, MachineSettings, VmError

    settings = MachineSettings(
        cpus=cpus,
        memory_mib=memory,
        icount_shift=icount,
        accelerator=accelerator,
        timeout_s=timeout,
        writable=writable,
    )
    image = _prepared()
    try:
        with StopRequest() as stop, Machine(
            image, settings, command, interactive=is_interactive
        ) as machine:
            code = machine.wait(stop.is_set)
    except VmError as error:
        click.echo(f"dbw: error: {error}", err=True)
        return EXIT_MACHINE
    return EXIT_INTERRUPTED if code is None else code


def _prepared() -> Image:
    """The image; the first time with a progress bar."""
    from rich.console import Console
    from rich.progress import Progress

    from runtime.vm import image

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("preparing the virtual machine", total=image.STEPS)

        def report(step: int, text: str) -> None:
            progress.update(task, completed=step, description=text)
            if not console.is_terminal:
                console.print(f"preparing the virtual machine: {text}")

        return image.prepare(report)
