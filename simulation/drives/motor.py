"""What a drive turns: a motor with inertia, friction, load, encoder and end stops. The truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

COUNTS_PER_REV: Final = 4096
"""Encoder units of one turn of the motor (UNICAMP Section 6.2)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorParams:
    """A direct-current motor (or a brushless one, commutated) with what it carries."""

    torque_constant_nm_per_a: float
    resistance_ohm: float
    supply_v: float
    inertia_kgm2: float
    """Rotor and load, at the motor's shaft."""
    friction_nm: float
    """Dry friction of motor and load."""
    current_rated_a: float
    """What motor and drive bear for ever."""
    current_a_max: float
    """What the drive gives at most."""
    stop_rad: float = math.inf
    """The mechanical end stop, either side, as an angle of the motor."""
    carried_inertia_kgm2: float = 0.0
    """What the load weighs at the shaft where the caller moves it: the loops are tuned for it."""

    def __post_init__(self) -> None:
        assert self.torque_constant_nm_per_a > 0.0 and self.resistance_ohm > 0.0
        assert self.inertia_kgm2 > 0.0 and self.friction_nm >= 0.0 and self.stop_rad > 0.0
        assert self.torque_constant_nm_per_a * self.current_a_max > self.friction_nm

    @property
    def no_load_speed_radps(self) -> float:
        """Speed at which the motor's own voltage equals the supply."""
        return self.supply_v / self.torque_constant_nm_per_a


RE50_ROTOR_KGM2: Final = 5.4e-5
EC45_ROTOR_KGM2: Final = 1.35e-5
"""Rotors without what they carry (Maxon's data)."""

RE50: Final = MotorParams(
    # Maxon RE 50, 24 V, 200 W (UNICAMP: "RE50"; which winding is an assumption)
    torque_constant_nm_per_a=0.0385,
    resistance_ohm=0.103,
    supply_v=14.8,  # UNICAMP Section 2: four cells
    # assumption: 5.4e-5 kg m2 of rotor, and half of a 20 kg car on a wheel of 85 mm behind 12:1
    inertia_kgm2=5.6e-4,
    friction_nm=0.02,  # assumption: brushes, gear and rolling
    current_rated_a=10.0,  # EPOS2 70/10: 10 A, 25 A for a short time
    current_a_max=25.0,
)
"""One rear wheel's motor."""

EC45: Final = MotorParams(
    # Maxon EC 45 flat, 24 V, 50 W (UNICAMP: "EC45"; which one is an assumption)
    torque_constant_nm_per_a=0.0335,
    resistance_ohm=1.03,
    supply_v=24.0,  # assumption: EPOS 24/2 takes 24 V, from UNICAMP's 25.9 V
    inertia_kgm2=2.0e-5,  # assumption: 1.35e-5 kg m2 of rotor, and the linkage behind its gear
    friction_nm=0.01,  # assumption
    current_rated_a=2.0,  # EPOS 24/2: 2 A, 4 A for a short time
    current_a_max=4.0,
)
"""The steering motor."""


class Motor:
    """A motor, integrated in small steps. What acts on the shaft besides is the caller's.

    Attributes:
        load_torque_nm: On the shaft.
        load_speed_radps: Of a load that drags the shaft towards its own speed, as a tyre on the
            road does, with `load_damping_nm_per_radps`.
        is_supplied: Whether there is any current to be had.
        angle_rad: True angle of the shaft; the encoder counts from 0, the index lies at whole
            turns.
        current_a: What flows now, after the drive's and the supply's limits.
        is_encoder_broken: The encoder stands still whatever the shaft does.
    """

    __slots__ = (
        "_frozen_counts", "angle_rad", "current_a", "is_encoder_broken", "is_supplied",
        "load_damping_nm_per_radps", "load_speed_radps", "load_torque_nm", "params", "speed_radps",
    )  # fmt: skip

    def __init__(self, params: MotorParams, *, angle_rad: float = 0.0) -> None:
        assert abs(angle_rad) <= params.stop_rad, "inside the end stops"
        self.params = params
        self.angle_rad = angle_rad
        self.speed_radps = 0.0
        self.current_a = 0.0
        self.load_torque_nm = 0.0
        self.load_speed_radps = 0.0
        self.load_damping_nm_per_radps = 0.0
        self.is_supplied = True
        self.is_encoder_broken = False
        self._frozen_counts = 0

    @property
    def counts(self) -> int:
        """What the encoder has counted."""
        if not self.is_encoder_broken:
            self._frozen_counts = math.floor(self.angle_rad * COUNTS_PER_REV / math.tau)
        return self._frozen_counts

    def step(self, current_a: float, dt_s: float) -> None:
        """One step with the current that the drive wants; the electrical lag is left out.

        The supply bounds the current by what is left over the motor's own voltage: above the
        no-load speed the motor brakes, never drives.
        """
        params = self.params
        back_v = params.torque_constant_nm_per_a * self.speed_radps
        high_a = min(params.current_a_max, (params.supply_v - back_v) / params.resistance_ohm)
        low_a = max(-params.current_a_max, (-params.supply_v - back_v) / params.resistance_ohm)
        # No current is no current, also above the no-load speed.
        is_driven = self.is_supplied and current_a != 0.0
        self.current_a = min(max(current_a, low_a), high_a) if is_driven else 0.0
        torque_nm = params.torque_constant_nm_per_a * self.current_a + self.load_torque_nm
        gain = dt_s / params.inertia_kgm2
        before = self.speed_radps
        drag = gain * self.load_damping_nm_per_radps  # implicit: stable however stiff it is
        speed = (before + gain * torque_nm + drag * self.load_speed_radps) / (1.0 + drag)
        friction = gain * params.friction_nm  # takes away at most the speed there is
        speed = math.copysign(max(0.0, abs(speed) - friction), speed)
        angle = self.angle_rad + 0.5 * dt_s * (before + speed)
        if abs(angle) >= params.stop_rad:
            angle = math.copysign(params.stop_rad, angle)
            speed = 0.0 if speed * angle > 0.0 else speed
        self.angle_rad, self.speed_radps = angle, speed
