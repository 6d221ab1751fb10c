"""What of a family bench does not live in the plant: the drive's position loop, for a trial through the whole stack.

The rule of this file: the plant's name carries serial, day and effects; the servo's loop is trimmed in the device, so
it goes with the plant model.  Run with serial 0 of the product, which scatters nothing besides.
"""

from __future__ import annotations

import math
from typing import Any

from tests.plants import bench_of

WIRE_EFFECTS = "end_delay, timestamp_skew, quantisation, lost_pdo, late_pdo"
"""Effects for the product's own plant model (`[effects.…]`), not for a plant's name."""


def plant_name(serial: int, day: int = 0, implementation: str = "bench", effects: tuple[str, ...] = (),
               draw: int | None = None) -> str:
    """The name under which `--plant` and `can.Bus(plant=…)` find a bench of the family; `draw`: seed of the effects."""
    name = "+".join([f"tests.plants:{implementation}_{serial}_day_{day}", *effects])
    return name if draw is None else f"{name}_draw_{draw}"


def plant_model(serial: int, implementation: str = "bench") -> dict[str, Any]:
    """Tables for `plant_model` (or `--plant-model` as TOML): the servo's position loop at the bench's own frequency.

    The loop's proportional gain is 2π·f, 1/s; a bench's frequency is 15 … 40 Hz.
    """
    bench = bench_of(f"{implementation}_{serial}")
    return {"servo_drive": {"position_gain": 2.0 * math.pi * bench.loop_hz}}


def toml(serial: int, implementation: str = "bench") -> str:
    """The same as the text of a TOML file."""
    return "".join(f"[{table}]\n" + "".join(f"{key} = {value!r}\n" for key, value in rows.items())
                   for table, rows in plant_model(serial, implementation).items())
