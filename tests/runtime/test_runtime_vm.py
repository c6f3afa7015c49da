"""The virtual machine without QEMU: its settings, its command line, its host and its image."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from dbw.main import main
from runtime.vm import host, image
from runtime.vm.host import VmError
from runtime.vm.image import Image
from runtime.vm.machine import MachineSettings, command_script, qemu_command

JOB = Path("/job")
IMAGE = Image(kernel=Path("/cache/vmlinuz"), initramfs=Path("/cache/initramfs.gz"))
NOT_A_NUMBER = float("nan")


@pytest.fixture(autouse=True)
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder in which the host finds programs; everything is there at first."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setattr(host, "SYSTEM_PATHS", ())
    (folder / "env").symlink_to("/usr/bin/env")
    for name in host.PACKAGE_OF_PROGRAM:
        write_program(folder, name, "")
    return folder


def write_program(folder: Path, name: str, script: str) -> None:
    path = folder / name
    path.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    path.chmod(0o755)


def write_apt(folder: Path, script: str) -> Path:
    """A Debian whose apt-get does as told, and writes down what it was asked for."""
    log = folder.parent / "apt.log"
    log.touch()
    write_program(folder, "apt-get", f'echo "${{3}} $*" >> {log}\n{script}')
    write_program(folder, "apt-cache", "")
    write_program(folder, "dpkg-deb", "")
    return log


def is_root(monkeypatch: pytest.MonkeyPatch, *, so: bool) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 0 if so else 1000)


def command_line(output: dict[str, int] | None = None, **settings: Any) -> str:
    given = MachineSettings(**settings)
    ports = {"stdout": 7, "stderr": 9} if output is None else output
    return " ".join(qemu_command(IMAGE, given, JOB, ports)) + " "


def test_machine_boots_the_image_with_two_controllers_on_one_wire() -> None:
    line = command_line()
    assert line.split()[0].endswith("/qemu-system-x86_64")
    assert "-kernel /cache/vmlinuz -initrd /cache/initramfs.gz " in line
    assert line.count("-device kvaser_pci,canbus=wire ") == 2
    assert "-accel tcg,thread=multi " in line and "-smp 2 -m 2048 " in line
    assert "-icount" not in line and "-no-reboot " in line and "panic=-1 oops=panic " in line


def test_processors_and_memory_are_as_asked_for() -> None:
    assert "-smp 3 -m 512 " in command_line(cpus=3, memory_mib=512)


def test_counting_instructions_takes_one_processor_and_skips_idle_time() -> None:
    line = command_line(icount_shift=2, cpus=4)
    assert "-icount shift=2,sleep=off " in line
    assert "-accel tcg,thread=single " in line and "-smp 1 " in line


def test_kvm_is_used_when_it_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: True)
    assert "-accel kvm " in command_line(accelerator="kvm")


def test_output_has_ports_of_its_own_and_the_console_a_file() -> None:
    line = command_line({"stdout": 7})
    assert "-serial file:/job/console " in line
    assert "-chardev file,id=stdout,path=/dev/fd/7 " in line
    assert "-device virtserialport,chardev=stdout,name=stdout " in line


def test_without_output_the_console_is_the_terminal() -> None:
    line = command_line({})
    assert "-chardev stdio,id=terminal,signal=off -serial chardev:terminal " in line
    assert "virtserialport" not in line


def test_host_is_shared_read_only_and_only_named_folders_are_writable(tmp_path: Path) -> None:
    odd = tmp_path / "a, b"
    odd.mkdir()
    line = command_line(writable=(tmp_path, odd))
    assert "local,path=/,mount_tag=host,security_model=none,readonly=on" in line
    assert f"local,path={tmp_path},mount_tag=write0,security_model=none,readonly=off" in line
    assert f"local,path={tmp_path}/a,, b,mount_tag=write1," in line
    assert line.count("readonly=off") == 3  # these two and the job


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"accelerator": "xen"}, "accelerator 'xen': allowed tcg, kvm"),
        ({"accelerator": "kvm", "icount_shift": 0}, "counting instructions needs the accelerator"),
        ({"icount_shift": -1}, "icount -1: allowed 0 to 10"),
        ({"icount_shift": 11}, "icount 11: allowed 0 to 10"),
        ({"cpus": 0}, "cpus 0: allowed 1 to 64"),
        ({"cpus": 65}, "cpus 65: allowed 1 to 64"),
        ({"memory_mib": 255}, "memory 255 MiB: at least 256"),
        ({"timeout_s": 0.0}, "timeout 0 s: allowed above 0"),
        ({"timeout_s": NOT_A_NUMBER}, "timeout nan s: allowed above 0"),
        ({"writable": (Path("/no/such"),)}, "/no/such: no folder that can be written to"),
        ({"writable": (Path("/etc/passwd"),)}, "/etc/passwd: no folder that can be written to"),
        ({"writable": (Path("/a\nb"),)}, r"'/a\\nb': a line break in the folder's name"),
    ],
)
def test_setting_that_cannot_be_is_refused_by_name(
    settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(VmError, match=f"^{message}"):
        MachineSettings(**settings)


def test_kvm_without_its_device_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(VmError, match="accelerator kvm: /dev/kvm cannot be used; use tcg"):
        MachineSettings(accelerator="kvm")


@pytest.mark.parametrize("arguments", [["--timeout", "nan"], ["--cpus", "0"], ["--icount", "x"]])
def test_wrong_option_is_one_line_and_exit_code_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["vm", "run", *arguments, "--", "true"]) == 2
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1 and arguments[-1] in shown


def test_vm_alone_shows_its_help_and_a_wrong_name_the_right_ones(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["vm"]) == 0
    assert "\n  shell " in capsys.readouterr().out
    assert main(["vm", "boot"]) == 2
    assert capsys.readouterr().err == (
        "dbw: error: no command 'boot': allowed prepare, run, shell\n"
    )


def run_script(command: list[str], folder: Path, environment: dict[str, str]) -> list[bytes]:
    """What a command that prints its arguments and environment, each ended by NUL, prints."""
    script = command_script(command, folder, environment)
    done = subprocess.run(
        ["/bin/sh", "-c", script.encode(errors="surrogateescape")],
        env={"PATH": "/usr/bin:/bin"}, capture_output=True, check=False,
    )
    return done.stdout.split(b"\0")


@pytest.mark.parametrize(
    "argument",
    ["", " ", "a b", "it's", '"$HOME"', "`id`", "line\nbreak", "\t", "ü €", "\\", "*", "a=b",
     "-x", "bytes \udcff"],
)
def test_argument_arrives_as_it_is(argument: str, tmp_path: Path) -> None:
    arrived = run_script(["printf", "%s\\0%s\\0", argument, "end"], tmp_path, {})
    assert arrived == [argument.encode(errors="surrogateescape"), b"end", b""]


@pytest.mark.parametrize(
    "name", ["HOME", "BASH_FUNC_x%%", "with.dot", "with space", "-i", "1", "ÜBER", "Q'"]
)
def test_environment_arrives_whatever_the_names(name: str, tmp_path: Path) -> None:
    value = "() { echo 'a\nb';  }"
    arrived = run_script(["env", "-0"], tmp_path, {name: value, "PATH": "/bin"})
    assert f"{name}={value}".encode() in arrived


def test_what_names_things_of_the_host_stays_there(tmp_path: Path) -> None:
    given = dict.fromkeys(("TMPDIR", "XDG_RUNTIME_DIR", "NOTIFY_SOCKET", "WATCHDOG_USEC"), "x")
    assert run_script(["env", "-0"], tmp_path, given) == [
        b"PATH=/usr/bin:/bin:/usr/sbin:/sbin", b""
    ]


def test_command_runs_in_the_same_folder(tmp_path: Path) -> None:
    odd = tmp_path / "it's a\nfolder"
    odd.mkdir()
    assert run_script(["printf", "%s\\0", "here"], odd, {})[0] == b"here"
    assert run_script(["pwd"], odd, {"PATH": "/bin"}) == [f"{odd}\n".encode()]


def test_folder_that_the_machine_does_not_see_is_named() -> None:
    script = command_script(["true"], Path("/no/such"), {})
    done = subprocess.run(["/bin/sh", "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 126
    assert done.stderr == "dbw vm: the machine does not see /no/such; --writable shows it\n"


def test_command_that_does_not_exist_ends_with_127(tmp_path: Path) -> None:
    script = command_script(["no-such-program"], tmp_path, {})
    done = subprocess.run(["/bin/sh", "-c", script], capture_output=True,
                          env={"PATH": "/usr/bin:/bin"}, check=False)
    assert done.returncode == 127 and b"no-such-program" in done.stderr


def test_missing_programs_are_installed_by_package(
    programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("candump", "cangw", "ip"):
        (programs / name).unlink()
    log = write_apt(programs, "")
    is_root(monkeypatch, so=True)
    assert host.missing_packages() == ["can-utils", "iproute2"]
    said: list[str] = []
    host.install(host.missing_packages(), said.append)
    assert said == ["installing can-utils iproute2"]
    assert log.read_text().endswith(
        "install -y --no-install-recommends can-utils iproute2\n"
    )


def test_busybox_that_needs_the_hosts_libraries_is_missing(programs: Path) -> None:
    write_program(programs, "busybox", "# /lib64/ld-linux-x86-64.so.2")
    assert host.missing_packages() == ["busybox-static"]


def test_list_of_packages_is_renewed_once_when_installing_fails(
    programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = programs / "fresh"
    log = write_apt(programs, f'[ "$3" = update ] && : > {fresh}; [ -e {fresh} ]')
    is_root(monkeypatch, so=True)
    host.install(["can-utils"], lambda text: None)
    assert [line.split()[0] for line in log.read_text().splitlines()] == [
        "install", "update", "install"
    ]


def test_installing_that_fails_says_what_to_type(
    programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_apt(programs, "exit 100")
    is_root(monkeypatch, so=True)
    with pytest.raises(VmError) as caught:
        host.install(["can-utils"], lambda text: None)
    assert str(caught.value) == (
        "apt-get could not install can-utils; try: sudo apt-get install can-utils"
    )


@pytest.mark.parametrize("sudo", [None, "exit 1"])
def test_user_who_may_not_install_is_told_the_command(
    sudo: str | None, programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = write_apt(programs, "")
    if sudo is not None:
        write_program(programs, "sudo", sudo)
    is_root(monkeypatch, so=False)
    with pytest.raises(VmError, match="kmod missing: sudo apt-get install can-utils kmod"):
        host.install(["can-utils", "kmod"], lambda text: None)
    assert log.read_text() == ""


def test_sudo_that_asks_nothing_is_used(programs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_apt(programs, "")
    write_program(programs, "sudo", 'shift; [ "$1" = true ] || exec "$@"')
    is_root(monkeypatch, so=False)
    host.install(["kmod"], lambda text: None)
    assert log.read_text().startswith("install ")


def test_host_that_is_no_debian_is_told_so() -> None:
    with pytest.raises(VmError, match="kmod missing, and this is no Debian: install them first"):
        host.install(["kmod"], lambda text: None)
    with pytest.raises(VmError, match=r"^this is no Debian: the virtual machine's kernel"):
        host.newest_kernel_package()


def test_missing_program_names_its_package(programs: Path) -> None:
    (programs / "qemu-system-x86_64").unlink()
    with pytest.raises(VmError) as caught:
        host.program("qemu-system-x86_64")
    assert str(caught.value) == (
        "qemu-system-x86_64 is missing: sudo apt-get install qemu-system-x86"
    )


def test_newest_kernel_is_what_debian_depends_on(programs: Path) -> None:
    write_apt(programs, "")
    answer = "linux-image-amd64\n  Depends: linux-image-6.1.0-9-amd64\n  Suggests: x"
    write_program(programs, "apt-cache", f"[ $LC_ALL = C ] && printf '{answer}'")
    assert host.newest_kernel_package() == "linux-image-6.1.0-9-amd64"


def test_kernel_that_apt_does_not_know_is_looked_for_after_an_update(
    programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = write_apt(programs, "")
    is_root(monkeypatch, so=True)
    with pytest.raises(VmError, match="apt knows no linux-image-amd64: try 'sudo apt-get update'"):
        host.newest_kernel_package()
    assert "update" in log.read_text()


def test_download_that_fails_says_what_to_try(
    programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_apt(programs, "exit 100")
    is_root(monkeypatch, so=False)
    with pytest.raises(VmError, match="cannot download linux-x: try 'sudo apt-get update' first"):
        host.download("linux-x", tmp_path)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder that is not there yet."""
    folder = tmp_path / "cache"
    monkeypatch.setenv(image.CACHE_VARIABLE, str(folder))
    return folder


def make(scratch: Path, report: image.Report) -> Path:
    made = scratch / "made"
    made.mkdir()
    (made / "vmlinuz").write_text("kernel", encoding="utf-8")
    return made


def test_image_is_made_once_and_then_found(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[int] = []
    monkeypatch.setattr(image, "_make", make)
    first = image.prepare(lambda step, text: steps.append(step))
    assert first.kernel.read_text() == "kernel" and first.kernel.is_relative_to(cache)
    assert steps == [image.STEPS]
    monkeypatch.setattr(image, "_make", None)
    assert image.prepare() == first


@pytest.mark.parametrize("failure", [KeyboardInterrupt, VmError("no"), ZeroDivisionError])
def test_interrupted_preparation_leaves_nothing(
    failure: Any, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(scratch: Path, report: image.Report) -> Path:
        make(scratch, report)
        raise failure

    monkeypatch.setattr(image, "_make", fail)
    with pytest.raises((KeyboardInterrupt, VmError, ZeroDivisionError)):
        image.prepare()
    assert list(cache.iterdir()) == []


def test_of_two_that_prepare_at_once_both_get_the_first_ones_image(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slowly(scratch: Path, report: image.Report) -> Path:
        monkeypatch.setattr(image, "_make", make)
        first = image.prepare()
        first.initramfs.write_text("first", encoding="utf-8")
        return make(scratch, report)

    monkeypatch.setattr(image, "_make", slowly)
    second = image.prepare()
    assert second.initramfs.read_text() == "first"
    assert [path.name for path in cache.iterdir()] == [second.kernel.parent.name]


def test_cache_that_cannot_be_written_to_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv(image.CACHE_VARIABLE, str(tmp_path / "file" / "cache"))
    with pytest.raises(VmError, match=r"cannot write to the cache \(CAN_BY_WIRE_CACHE\): .*file"):
        image.prepare()


def test_cache_is_where_the_user_keeps_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(image.CACHE_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/caches")
    assert image.cache_folder() == Path("/caches/can-by-wire")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/driver")
    assert image.cache_folder() == Path("/home/driver/.cache/can-by-wire")
    monkeypatch.setenv(image.CACHE_VARIABLE, "/mine")
    assert image.cache_folder() == Path("/mine")


def test_another_recipe_is_another_image(monkeypatch: pytest.MonkeyPatch) -> None:
    before = image.recipe()
    monkeypatch.setattr(image, "MODULES", (*image.MODULES, "slcan"))
    assert image.recipe() != before
