"""A family of benches written apart from `physics`: plants by serial and day behind the real nodes.

The rule of this file: a plant's name says everything, so that nothing of the product has to know of serials here.
`tests.plants:bench_17_day_1` is serial 17 on day 1; `tests.plants:maxwell_17_day_1` the same with that method;
`…+fabric_friction` hides an effect in it, drawn from the bench's seed, `…+fabric_friction_draw_3` from seed 3;
`…_up_60` or `…_down_60` moves its zero by 60 µm/s; `tests.plants:family` takes the seed for the serial.  See
docs/family.md.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

_NAME = re.compile(r"(?P<kind>family|bench|maxwell|lugre|dahl|fronts)(_(?P<serial>\d+))?(_day_(?P<day>\d+))?"
                   r"(_(?P<way>up|down)_(?P<rate>\d+))?(?P<hidden>(\+[a-z_]+?)*)(_draw_(?P<draw>\d+))?")


def bench_of(name: str, seed: int = 0) -> Any:
    """The `Bench` of a plant's name; raises `AttributeError` where it is no name of the family."""
    found = _NAME.fullmatch(name)
    if found is None:
        raise AttributeError(f"{name} is no plant of the family; see docs/family.md")
    from tests.plants import draws, effects
    from tests.plants.bench import replaced

    kind = found["kind"]
    serial = seed if found["serial"] is None else int(found["serial"])
    bench = draws.draw(serial, int(found["day"] or 0), None if kind in ("family", "bench") else kind)
    hidden = [part for part in found["hidden"].split("+") if part]
    for part in hidden:
        if part not in effects.IN_PLANT:
            raise AttributeError(f"{part} is no effect that a plant of the family can have")
    rate = {"up": 1e-6, "down": -1e-6, None: 0.0}[found["way"]] * float(found["rate"] or 0)
    return effects.hide(replaced(bench, zero_rate=rate), hidden, int(found["draw"] or seed))[0]


def __getattr__(name: str) -> Callable[[dict[str, float], int], Any]:
    if _NAME.fullmatch(name) is None:
        raise AttributeError(name)
    bench_of(name)

    def create(parameters: dict[str, float], seed: int) -> Any:
        del parameters  # the product's scatter is not this family's
        from tests.plants.plant import FamilyPlant

        return FamilyPlant(bench_of(name, seed))

    return create
