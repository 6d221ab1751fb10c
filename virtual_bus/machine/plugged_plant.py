"""Plug-in plants behind the nodes: an exception of a plug-in becomes one sentence that names it.

A plant that raised holds its last outputs afterwards, so that the drives can still be switched off.
"""

from collections.abc import Mapping

from parameters import InputError
from physics.plant.bench_plant import Outputs, Plant


class PluggedPlant:
    """A plug-in plant with its name; it passes every call on."""

    def __init__(self, name: str, plant: Plant) -> None:
        self._name, self._plant = name, plant
        self._held: Outputs | None = None
        self._failed = False
        self._enabled = True

    def reset(self, time_ns: int) -> Outputs:
        """Return to the state at power-on; raises `InputError` if the plug-in raises."""
        try:
            self._held = self._plant.reset(time_ns)
        except Exception as error:  # a plug-in may raise anything
            raise plant_raised(self._name, error, "at its reset") from None
        return self._held

    def advance(self, until_ns: int, servo_torque_nm: float, knee_torque_nm: float) -> Outputs:
        """Return the outputs at `until_ns`; raises `InputError` once if the plug-in raises, and holds them then."""
        if self._failed and self._held is not None:
            return self._held
        if not self._enabled:
            servo_torque_nm = knee_torque_nm = 0.0
        try:
            self._held = self._plant.advance(until_ns, servo_torque_nm, knee_torque_nm)
        except Exception as error:  # a plug-in may raise anything
            self._failed = True
            raise plant_raised(self._name, error, f"at {until_ns / 1e9:.6g} s") from None
        return self._held

    def enable(self, closed: bool) -> None:
        """Close or open the enable line (STO): open, the plug-in receives no torque, and is informed if it can be."""
        self._enabled = closed
        inform = getattr(self._plant, "enable", None)
        if inform is not None:
            inform(closed)

    def second_sensors(self) -> tuple[float, float, float, float]:
        """Return the plug-in's second set of sensors, see `BowdenPlant`; without one, its true tensions, leg and rope.

        Raises `InputError` if the plug-in has neither.
        """
        measure = getattr(self._plant, "second_sensors", None)
        if measure is not None:
            start_n, end_n, knee_rad, rope_m = measure()
            return float(start_n), float(end_n), float(knee_rad), float(rope_m)
        true = self._plant.truth()
        if self._held is None or not {"true_start_n", "true_end_n"} <= set(true):
            raise InputError(f"plant {self._name!r}: has neither second_sensors() nor true_start_n and true_end_n in "
                             "truth(), one of which a safety monitor measures with; see docs/plants.md.")
        held = self._held
        return float(true["true_start_n"]), float(true["true_end_n"]), held.knee_angle_rad, held.servo_position_m

    def truth(self) -> Mapping[str, float]:
        """Return the plug-in's true signals."""
        return self._plant.truth()


def plant_raised(name: str, error: Exception, when: str) -> InputError:
    """Return the error for a plug-in plant that raised: plug-in, kind, text, file and line."""
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    where = "" if frame is None else f" in {frame.tb_frame.f_code.co_filename}, line {frame.tb_lineno}"
    text = " ".join(str(error).split())[:300]
    return InputError(f"plant {name!r} raised {type(error).__name__}{f' ({text})' if text else ''} {when}{where}; "
                      "mend the plug-in.")
