"""The CANopen side of this project's own nodes: configuration hashes and parameters in SI."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType

from canbus import canopen_protocol as cia301
from canbus.canopen_device import ALL_INDICES, CanopenDevice
from canbus.canopen_parameters import Parameter, raw_in_units, raw_values
from canbus.canopen_protocol import (
    CanopenEvent,
    CanopenEventKind,
    NmtCommand,
    NmtState,
    SdoAbort,
    SdoClient,
    heartbeat_state,
    nmt_frame,
)

__all__ = [
    "CanopenEvent",
    "CanopenEventKind",
    "CanopenNode",
    "NmtCommand",
    "NmtState",
    "SdoAbort",
    "SdoClient",
    "heartbeat_state",
    "nmt_frame",
]


class CanopenNode(CanopenDevice):
    """One of our nodes: a `CanopenDevice` with the hashes in 0x2000 and parameters in 0x2100.

    Args:
        node_id: 1 to 127.
        eds: path of an EDS file (CiA 306), or its text.
        dbc_hash: 0x2000:1, what the supervisor compares before it authorises.
        vehicle_hash: 0x2000:2, likewise.
        parameters: values in SI for exactly the names in record 0x2100. Clients see them rounded
            to the EDS's Factor.
        heartbeat_period_ns: start value of 0x1017, whole milliseconds.
        emcy_inhibit_ns: start value of 0x1015, whole 100 us: least time between emergencies.

    Attributes:
        writable: whether clients may write at all; False at start. The owner sets it every step.

    Raises:
        ValueError: EDS incomplete, a parameter missing, unknown, not finite or out of its limits,
            a period out of range; the message names it.
        OSError: the EDS file cannot be read.
    """

    def __init__(
        self,
        node_id: int,
        eds: str | Path,
        *,
        dbc_hash: int,
        vehicle_hash: int,
        parameters: Mapping[str, float],
        heartbeat_period_ns: int = 50_000_000,
        emcy_inhibit_ns: int = 50_000_000,
    ) -> None:
        super().__init__(node_id, eds, required=cia301.REQUIRED_OBJECTS)
        self.writable = False
        self._values: dict[str, float] = {}
        self._parameters = self._described_parameters()
        self._start_values = [
            (index, subindex, raw_in_units(self.describe(index, subindex), value, unit))
            for index, subindex, value, unit in (
                (cia301.CONFIGURATION, 1, dbc_hash, 1),
                (cia301.CONFIGURATION, 2, vehicle_hash, 1),
                (cia301.HEARTBEAT_TIME, 0, heartbeat_period_ns, cia301.HEARTBEAT_UNIT_NS),
                (cia301.EMCY_INHIBIT, 0, emcy_inhibit_ns, cia301.INHIBIT_UNIT_NS),
            )
        ]
        for subindex, raw in raw_values(self._parameters.values(), parameters).items():
            self._start_values.append((cia301.PARAMETERS, subindex, raw))
        self._reset_objects(ALL_INDICES)

    @property
    def parameters(self) -> Mapping[str, float]:
        """The parameters in force, in SI, rounded to their Factor (a live, read-only view)."""
        return MappingProxyType(self._values)

    def _described_parameters(self) -> dict[int, Parameter]:
        """The members of record 0x2100 by sub-index."""
        members = self.members(cia301.PARAMETERS)
        if members == [0]:
            raise ValueError("EDS: object 2100 must be a record")
        return {
            subindex: Parameter.from_eds(self.describe(cia301.PARAMETERS, subindex))
            for subindex in members
            if subindex
        }

    def _refusal(self, index: int, subindex: int, raw: int) -> int:
        return 0 if self.writable else cia301.ABORT_STATE

    def _written(self, index: int, subindex: int, raw: int) -> None:
        if index == cia301.PARAMETERS:
            parameter = self._parameters[subindex]
            value = self._values[parameter.name] = parameter.si(raw)
            kind = CanopenEventKind.PARAMETER_WRITTEN
            self._events.append(CanopenEvent(kind=kind, name=parameter.name, value=value))

    def _objects_reset(self, indices: Collection[int]) -> None:
        if cia301.PARAMETERS in indices:
            for index, subindex, raw in self._start_values:
                if index == cia301.PARAMETERS:
                    parameter = self._parameters[subindex]
                    self._values[parameter.name] = parameter.si(raw)
