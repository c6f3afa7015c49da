"""A small virtual machine with real SocketCAN, for kernels without it."""

from runtime.vm.host import VmError
from runtime.vm.image import Image, prepare
from runtime.vm.machine import Machine, MachineSettings, run

__all__ = ["Image", "Machine", "MachineSettings", "VmError", "prepare", "run"]
