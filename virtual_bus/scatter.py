"""How a bench departs from the nominal one: by its making (serial number), and from day to day.

The rule of this file: each parameter draws from its own stream, named by the parameter, so that a row more
in a table changes no other draw. Serial 0 is the nominal bench, day 0 the day of the identification.
"""

from __future__ import annotations

import zlib
from collections.abc import Container, Mapping
from typing import Final, NamedTuple

import numpy as np

SENSOR: Final = {"start": "start_sensor", "end": "end_sensor"}


class Spread(NamedTuple):
    """One scattered parameter: `law` with a number u drawn evenly from −1 … 1, and where its size comes from."""

    group: str
    name: str
    law: str
    size: float
    source: str

    @property
    def label(self) -> str:
        """Group and name, as "plant.mu1"."""
        return f"{self.group}.{self.name}"


LAWS: Final = {
    "factor": "value · (1 + size · u)",
    "offset": "value + size · u",
    "excess": "value + size · (1 + u) / 2",
    "set": "size, whatever u is",
}

SERIAL: Final = (
    Spread("plant", "mu1", "factor", 0.25, "assumed: lubrication, sheath"),
    Spread("plant", "mu2", "factor", 0.25, "assumed: weave, finish of the knee"),
    Spread("plant", "servo_coulomb_n", "factor", 0.25, "assumed: bearings, seals"),
    Spread("plant", "knee_coulomb_nm", "factor", 0.25, "assumed: bearings, seals"),
    Spread("plant", "stiffness_scale", "factor", 0.10, "assumed: length and weave of the strap"),
    Spread("plant", "wrap_rad", "factor", 0.25, "assumed: fit of the strap"),
    Spread("plant", "fabric_wrap", "factor", 0.10, "assumed: fit of the strap"),
    Spread("plant", "presliding_m", "factor", 0.30, "assumed: as friction, and more"),
    Spread("plant", "fabric_presliding_m", "factor", 0.30, "assumed: as friction, and more"),
    Spread("start_sensor", "gain", "offset", 0.005, "maker's class 0.5"),
    Spread("end_sensor", "gain", "offset", 0.005, "maker's class 0.5"),
    Spread("start_sensor", "offset_n", "offset", 0.1, "assumed: 0.05 % of full scale"),
    Spread("end_sensor", "offset_n", "offset", 0.1, "assumed: 0.05 % of full scale"),
    Spread("servo_drive", "position_gain", "factor", 0.25, "bandwidth of the position loop, 25 Hz ± 25 %"),
)
"""Manufacturing tolerances."""

DAY: Final = (
    Spread("plant", "encoder_zero_m", "offset", 0.1e-3, "repeatability of homing to a preload"),
    Spread("plant", "mu1", "factor", 0.10, "assumed: temperature, humidity"),
    Spread("plant", "mu2", "factor", 0.10, "assumed: temperature, humidity"),
    Spread("plant", "stiffness_scale", "factor", 0.03, "assumed: temperature, humidity, history"),
    Spread("start_sensor", "offset_n", "offset", 0.2, "assumed: temperature of the bridge"),
    Spread("plant", "creep_compliance", "excess", 0.01e-3, "assumed: woven strap under load"),
    Spread("plant", "stribeck_ratio", "excess", 0.3, "assumed: breakaway after a night's rest; paper, Fig. 15"),
    Spread("plant", "knee_backlash_rad", "set", float(np.radians(0.3)), "maker's class of the reducer, worn in"),
)
"""What changes from day to day."""

Tables = dict[str, dict[str, float]]


def scattered(
    nominal: Mapping[str, Mapping[str, float]], serial: int, day: int, steady: Container[str] = ()
) -> Tables:
    """Return the tables of parameters, by group, of bench `serial` on `day`; a day leaves `steady` as they were."""
    tables = {group: dict(values) for group, values in nominal.items()}
    if serial:
        for spread in SERIAL:
            _apply(tables[spread.group], spread, draw("serial", spread, serial))
    if day:
        for spread in DAY:
            if spread.label not in steady:
                _apply(tables[spread.group], spread, draw("day", spread, serial, day))
    return tables


def draw(occasion: str, spread: Spread, *numbers: int) -> float:
    """Return this parameter's u, −1 … 1, of an occasion with its numbers."""
    return 2.0 * float(stream(f"{occasion} {spread.group} {spread.name}", *numbers).random()) - 1.0


def stream(name: str, *numbers: int) -> np.random.Generator:
    """Return the stream of random numbers that belongs to a name and some numbers."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([zlib.crc32(name.encode()), *numbers])))


def _apply(table: dict[str, float], spread: Spread, u: float) -> None:
    value = table[spread.name]
    table[spread.name] = {
        "factor": value * (1.0 + spread.size * u),
        "offset": value + spread.size * u,
        "excess": value + spread.size * (1.0 + u) / 2.0,
        "set": spread.size,
    }[spread.law]
