"""The servo drive at the rope's drum: a CiA 402 drive that keeps the rope's tension within its limit by itself.

START's tension comes straight from the bus (0x2011), and its limits override every master: above 0x2012 the drum
unwinds, above 0x2013 the drive faults, and without a trusted tension the torque is bounded by 0x2015.
"""

import math
from typing import Final

from eds.cia301 import Emcy
from eds.dictionary import key
from nodes.core.application import ProfileHost
from nodes.drives import axis_law as law
from nodes.drives.axis_law import FEELS, NEWTON, NO_TENSION, RpdoEffect, feel
from nodes.drives.drive import Drive

TENSION: Final = key(0x2011)
HYSTERESIS_N: Final = 1.0


class ServoDrive(Drive):
    """The rope's drive; positions in m of rope (> 0 pulling), torques in N·m at the drum."""

    def __init__(self) -> None:
        super().__init__()
        self._no_tension = False
        self._above = False
        self._tripped = False
        self._limit = self._trip = math.inf

    def attach(self, device: ProfileHost) -> None:
        """Register for START's tension in addition to the axis' objects."""
        super().attach(device)
        self._writers[TENSION] = self._feel
        self.unstored |= {TENSION}

    def configure(self) -> None:
        """Copy the tension objects to the axis in addition to its settings."""
        super().configure()
        g, units = self.axis.g, self.axis.units
        self._limit = NEWTON * self.number(0x2012) or math.inf
        self._trip = NEWTON * self.number(0x2013) or math.inf
        g[law.TENSION_LIMIT] = self._limit
        g[law.HOLD_TORQUE] = self._limit * units.arm_m
        g[law.YIELD_PER_N] = law.YIELD_RATE / self.number(0x2014)
        g[law.UNTRUSTED_TORQUE] = self.number(0x2015) * units.torque
        g[law.GAINED_LIMIT] = law.GAINED_M_S
        g[law.PRELOAD] = NEWTON * self.number(0x2010)
        g[law.TRAVEL] = self.number(0x2016) * units.position

    def ready(self) -> bool:
        """Return whether the drive may be enabled: not while the sensor reports an invalid value."""
        return super().ready() and not self._no_tension

    def cured(self) -> bool:
        """Return whether no fault is present; a rope above the trip level is one."""
        return super().cured() and not self._tripped

    def warned(self) -> bool:
        """Return whether the statusword warns: the rope tension is above its limit."""
        return self._above

    def _feel(self, raw: int, now_ns: int) -> None:
        """Receive START's tension."""
        if raw == NO_TENSION:
            self._feel_nothing(now_ns)
            return
        tension = feel(self.axis.s, raw)
        self._no_tension = False
        if tension > self._limit or self._above:
            self._press(tension, now_ns)

    def rpdo_effect(self, at: int) -> RpdoEffect | None:
        """Return the effect of an object of an RPDO on the axis; of START's tension only while it is valid and below
        the rope's limit, else None.
        """
        if at != TENSION:
            return super().rpdo_effect(at)
        return None if self._no_tension or self._above else RpdoEffect(FEELS, most=self._limit)

    def _press(self, tension: float, now_ns: int) -> None:
        above = tension > self._limit - (HYSTERESIS_N if self._above else 0.0)
        tripped = tension > self._trip - (HYSTERESIS_N if self._tripped else 0.0)
        if tripped and not self._tripped:
            self.fault(Emcy.TENSION_LIMIT, now_ns)
        self._tripped = tripped
        if above is not self._above:
            self._above = above
            self.show()

    def _feel_nothing(self, now_ns: int) -> None:
        """React to START's value "not valid" as to a lost START."""
        self.axis.state[law.TENSION_AGE_S] = math.inf
        if not self._no_tension:
            self._no_tension = True
            self.disconnected(Emcy.SENSOR_BROKEN, now_ns, announce=True)
