"""`dbw up`, `dbw ecu`, `dbw down`, `dbw status`: the stack as processes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from dbw.failures import EXIT_FAILED, EXIT_OK, UserMistake
from dbw.options import (
    bitrate_option,
    bus_options,
    channel_option,
    check_two_buses,
    interface_option,
    realtime_options,
    vehicle_option,
)

if TYPE_CHECKING:
    from canbus.node import Event
    from runtime.launch import StackState
    from runtime.realtime import RealtimeSettings
    from runtime.status import BusStatus

NO_PLANT = "none"


@click.command(
    epilog="""\b
Examples:
  dbw up --interface socketcan --channel vcan0 --harness-channel vcan1
  dbw up --interface socketcan --channel can0 --harness-channel vcan1 --plant none
  dbw up --channel can0 --plant none --realtime fifo:40 --lock-memory --cpus 2,3"""
)
@interface_option
@bus_options
@bitrate_option
@vehicle_option
@click.option(
    "--plant",
    default=None,
    metavar="NAME|none",
    help="The simulated car behind the harness; none on a real car.  [default: the vehicle's]",
)
@realtime_options
def up(
    interface: str,
    channel: str,
    harness_channel: str,
    bitrate_bps: int | None,
    vehicle: str,
    plant: str | None,
    realtime: RealtimeSettings,
) -> int:
    """Start all nodes and the car, each in a process of its own.

    Runs until Ctrl-C, SIGTERM or `dbw down`; then the car is stopped first, and the nodes after
    it. A node that dies or hangs is reported by name, and the others bring the car to a stand.
    Under systemd it tells when it is ready, and pings the watchdog as long as every node lives.
    """
    from runtime.launch import ProcessStack, StackSettings
    from runtime.nodes import NODES
    from runtime.realtime import apply_realtime
    from runtime.stopping import StopRequest

    with_plant = _wants_plant(vehicle, plant)
    settings = StackSettings(
        interface=interface,
        channel=channel,
        harness_channel=harness_channel,
        vehicle=vehicle,
        with_plant=with_plant,
        bitrate_bps=bitrate_bps,
        realtime=realtime,
    )
    check_two_buses(channel, harness_channel)
    _open_once(interface, bitrate_bps, channel, harness_channel)
    # Its watchdog must not starve beside nodes that run first; and one line tells what is refused.
    apply_realtime(realtime)
    with StopRequest() as stop, ProcessStack(settings, report=_say) as stack:
        click.echo(
            f"{len(NODES)} nodes{' and the plant' if with_plant else ''} on {interface} {channel}, "
            f"harness {harness_channel}; stop with Ctrl-C or: dbw down --channel {channel}"
        )
        return stack.supervise(stop)


def _wants_plant(vehicle: str, plant: str | None) -> bool:
    """Checks vehicle and plant; whether a plant is to be started."""
    from vehicles import load_vehicle

    name = load_vehicle(vehicle).name
    if plant == NO_PLANT:
        return False
    if plant is not None and plant != name:
        raise UserMistake(f"--plant {plant}: allowed {name} (the vehicle's own) or {NO_PLANT}")
    return True


def _open_once(interface: str, bitrate_bps: int | None, *channels: str) -> None:
    """Opens each bus once, so that one line tells what six processes would tell six times."""
    from canbus.python_can_bus import PythonCanBus
    from runtime.clock import monotonic_ns, realtime_ns

    for channel in channels:
        with PythonCanBus(
            interface, channel, clock=monotonic_ns, realtime=realtime_ns, bitrate=bitrate_bps
        ):
            pass


def _say(event: Event) -> None:
    """An event as a line on stderr; of several processes each writes whole lines."""
    click.echo(f"{event.node}: {event.kind}: {event.text}", err=True)


@click.command(
    epilog="""\b
Examples:
  dbw ecu steering --interface socketcan --channel can0 --harness-channel vcan1
  dbw ecu plant --interface socketcan --channel vcan0 --harness-channel vcan1"""
)
@click.argument("name", default="")
@interface_option
@bus_options
@bitrate_option
@vehicle_option
@realtime_options
def ecu(
    name: str,
    interface: str,
    channel: str,
    harness_channel: str,
    bitrate_bps: int | None,
    vehicle: str,
    realtime: RealtimeSettings,
) -> int:
    """Run a single node until Ctrl-C.

    NAME: steering, throttle, brake_servo, supervisor, safety_monitor, or plant for the simulated
    car. What the node reports goes to stderr.
    """
    from runtime.node_process import run_node_process
    from runtime.nodes import NODES, PLANT, node_entry
    from runtime.plant_process import run_plant_process
    from runtime.process_settings import ProcessSettings

    if not name:
        raise UserMistake(f"NAME is missing: allowed {', '.join((*NODES, PLANT))}")
    if name != PLANT:
        node_entry(name)
    check_two_buses(channel, harness_channel)
    settings = ProcessSettings(
        name=name,
        vehicle=vehicle,
        interface=interface,
        channel=channel,
        harness_channel=harness_channel,
        bitrate_bps=bitrate_bps,
        realtime=realtime,
    )
    run = run_plant_process if name == PLANT else run_node_process
    return run(settings, _say).exit_code


@click.command(
    epilog="""\b
Example:
  dbw down --channel vcan0"""
)
@channel_option
def down(channel: str) -> int:
    """Stop a stack that is up, brakes first.

    Waits until it is gone. A stack whose launcher was killed is cleared up as well.
    """
    from runtime.launch import known_channels, status, stop

    if status(channel) is None:
        others = ", ".join(known_channels()) or "none"
        raise UserMistake(f"no stack is up on channel {channel!r}: stacks are up on {others}")
    result = stop(channel)
    if result.was_stale:
        click.echo(f"{channel}: nothing was running any more; cleared up")
    else:
        click.echo(f"{channel}: stopped {', '.join(result.stopped) or 'nothing'}")
    if result.killed:
        click.echo(f"{channel}: had to be killed: {', '.join(result.killed)}", err=True)
        return EXIT_FAILED
    return EXIT_OK


@click.command(
    epilog="""\b
Example:
  dbw status --channel vcan0"""
)
@channel_option
def status(channel: str) -> int:
    """Tell what is up and what the bus says.

    Shows the processes of a stack, listens to its vehicle bus for half a second without sending
    anything, and ends with 0 only if every process runs and every node is heard.
    """
    from runtime.launch import known_channels
    from runtime.launch import status as stack_on

    state = stack_on(channel)
    if state is None:
        others = ", ".join(known_channels())
        also = f"; stacks are up on {others}" if others else ""
        click.echo(f"no stack is up on channel {channel}{also}")
        return EXIT_FAILED
    is_complete = _print_processes(state)
    bus = _listen(state)
    if bus is not None:
        is_complete &= _print_bus(state, bus)
    return EXIT_OK if is_complete and bus is not None else EXIT_FAILED


def _print_processes(state: StackState) -> bool:
    """The processes; whether all of them run."""
    click.echo(
        f"{state.interface} {state.channel}, harness {state.harness_channel}, "
        f"vehicle {state.vehicle}"
    )
    is_complete = True
    for record in (state.launcher, *state.nodes):
        is_alive = state.is_alive(record)
        is_complete &= is_alive
        click.echo(f"  {record.name:<15} process {record.pid:<8} {'runs' if is_alive else 'DEAD'}")
    return is_complete


def _listen(state: StackState) -> BusStatus | None:
    from canbus.bus import BusError
    from canbus.python_can_bus import PythonCanBus
    from runtime.clock import monotonic_ns, realtime_ns
    from runtime.status import listen

    try:
        with PythonCanBus(
            state.interface, state.channel, clock=monotonic_ns, realtime=realtime_ns
        ) as bus:
            return listen(bus, monotonic_ns)
    except BusError as error:
        click.echo(f"the bus cannot be heard: {error}", err=True)
        return None


def _print_bus(state: StackState, bus: BusStatus) -> bool:
    """What the bus says; whether every node but the planner's gateway is heard."""
    from runtime.status import bus_load
    from vehicles import load_vehicle

    load = bus_load(bus, load_vehicle(state.vehicle).bus.bitrate_bps)
    mode = "not heard" if bus.mode is None else bus.mode.name
    inhibit = "" if bus.inhibit is None or not bus.inhibit else f" ({bus.inhibit.name})"
    verdict = "not heard" if bus.verdict is None else bus.verdict.name
    reason = "" if not bus.verdict_reason else f" ({bus.verdict_reason.name})"
    click.echo(f"  mode {mode}{inhibit}, verdict {verdict}{reason}, bus load {100 * load:.1f} %")
    click.echo(f"  codes {' '.join(code.name for code in bus.codes) or 'none'}")
    for node in bus.nodes:
        nmt = "-" if node.nmt is None else node.nmt.name
        own = "" if node.state is None else node.state.name
        heard = f"{node.frames_per_s:4.0f} frames/s" if node.is_heard else "not heard"
        click.echo(f"  {node.name:<15} {heard:<15} {nmt:<16} {own}".rstrip())
    for fault, count in bus.bad_frames.items():
        click.echo(f"  bad frames: {count} {fault.name}")
    if bus.error_frames:
        click.echo(f"  error frames: {bus.error_frames}")
    if bus.unknown_ids:
        click.echo(f"  unknown: {' '.join(f'0x{can_id:03X}' for can_id in bus.unknown_ids)}")
    return all(node.is_heard for node in bus.nodes if node.name != "Gateway")
