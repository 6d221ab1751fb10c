"""Commands of the first day of six users: `python -m benchmarks.walk [--user data|controller|can|months|bench|rig …]`.

Prints for each user the time to the first success, and for each command its time, exit status and messages.  Exits
with status 1 if a command prints a traceback or ends with another exit status than expected.
"""

import argparse
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

BOWDEN: Final = (sys.executable, "-c", "from bowden.cli import main; main()")
SHORT: Final = "--cycles 2 --settle 0 --period 1.0"
LONG_SWEEP: Final = "sweep --grid seed=1-4 --grid cycles=2 --grid settle=0 --workers 1 -o long.csv"
CONTROLLER: Final = '''from dataclasses import dataclass
from bowden.controllers import Controller, ControllerOutput, Trace, parameter

@dataclass(frozen=True)
class Gains:
    share: float = parameter(1.0, "", "share of the stretch fed forward", low=0.5, high=1.5, source="tuned")

class Own(Controller[None]):
    parameters = Gains
    def __init__(self, model, gait, conditions):
        self.gait, self.share = gait, conditions.own.share
    def initial(self):
        return None
    def step(self, seen, state):
        i = seen.sample % self.gait.samples
        target = self.share * self.gait.stretch[i] + self.gait.swing[i] - self.gait.slack[i]
        return ControllerOutput(target, self.gait.knee[i]), None, Trace(self.gait.desired[i])
'''


class Typed(NamedTuple):
    """Command line after `bowden`, its expected exit status, and whether it is the user's aim.

    `ctrl_c`: the keyboard's interrupt reaches the command and its processes as soon as the file of this name is there.
    """

    words: str
    status: int = 0
    success: bool = False
    ctrl_c: str = ""


def _table() -> None:
    rows = ["Zeit [s];Seilweg [mm];Kraft vorne [g];Kraft hinten [g];Knie [deg];Bemerkung"]
    for k in range(1200):
        end = 12.0 + 10.0 * math.sin(math.pi * k / 100)
        turn = math.cos(math.pi * k / 100)
        start = end * (1.3 + 0.2 * math.tanh(3.0 * turn))
        slow = f"{20 + 0.3 * end:.4f}" if k % 10 == 0 else ""
        rows.append(f"{k / 100:.2f};{slow};{102 * start:.3f};{102 * end:.3f};{20 + 5 * turn:.3f};x"
                    .replace(".", ","))
    Path("lab.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    Path("overload.csv").write_text("time_s,tension_start_n,tension_end_n\n0,OL,1\n0.01,2,1\n", encoding="utf-8")
    Path("unit.csv").write_text("time_s,servo_position_m,tension_start_n\n0,31,1\n10,32,2\n", encoding="utf-8")
    for name in ("empty.csv", "empty.blf", "empty.mcap"):
        Path(name).touch()
    Path("folder.mcap").mkdir()


def _controller() -> None:
    Path("own.py").write_text(CONTROLLER, encoding="utf-8")


def _worn() -> None:
    Path("worn.right.toml").write_text("[effects.presliding]\npresliding = 3e-4\n", encoding="utf-8")


def _cut_logs() -> None:
    """Write CAN logs in which the payload of a servo PDO is cut, and one in which a line cannot be read."""
    whole = "   {:.6f} 1  181             Rx   d 8 37 12 9D 52 00 00 F6 FF"
    lines = ["date Sat Nov 28 12:00:00.000 2026", "base hex  timestamps absolute", "internal events logged",
             *(whole.format(0.1 + k / 1000) for k in range(20))]
    Path("short.asc").write_text("\n".join([*lines, whole.format(0.2)[:-12], ""]), encoding="utf-8")
    Path("broken.asc").write_text("\n".join([*lines, whole.format(0.2)[:-26], ""]), encoding="utf-8")
    Path("short.log").write_text("(1.000000) can0 181#37129D520000F6FF\n(1.001000) can0 181#3712", encoding="utf-8")


def _axis() -> None:
    """Write three recordings of an axis without rope and knee; its viscous friction has grown in the third."""
    for name, viscous, other in (("good", 0.05, 1.0), ("good2", 0.05, 1.3), ("worn", 0.12, 1.0)):
        rows, slip, before = ["time_s,servo_position_rad,servo_torque_nm"], 0.0, 0.0
        for k in range(12_000):
            moves = [(w, size, w * k / 500) for w, size in ((3.1 * other, 1.0), (7.2, 0.3))]
            angle = sum(size * math.sin(at) for _, size, at in moves)
            speed = sum(size * w * math.cos(at) for w, size, at in moves)
            push = -sum(size * w**2 * math.sin(at) for w, size, at in moves)
            slip += (angle - before) * (1.0 - slip * math.copysign(1.0, angle - before)) / 0.01
            before = angle
            noise = 0.004 * math.sin(1e4 * math.sin(k))
            rows.append(f"{k / 500:.3f},{angle:.6f},{0.02 * push + 0.3 * slip + viscous * speed + noise:.5f}")
        Path(f"{name}.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


USERS: Final[dict[str, tuple[Callable[[], None], tuple[Typed, ...]]]] = {
    "data": (_table, (Typed("info lab.csv"), Typed("diagnose lab.csv", 2), Typed("import lab.csv --guess -o map.toml"),
                      Typed("import lab.csv --map map.toml -o lab.mcap"),
                      Typed("report lab.mcap -o lab.html", success=True), Typed("report lab.csv -o lab.html", 2),
        *(Typed(f"info {name}", 2) for name in ("empty.csv", "empty.blf", "empty.mcap", "folder.mcap")),
        Typed("import overload.csv -o overload.mcap", 2), Typed("import overload.csv --guess -o overload.toml"),
        Typed("import overload.csv --map overload.toml -o overload.mcap"), Typed("import unit.csv -o unit.mcap"))),
    "controller": (_controller, (
        Typed(f"trial --controller own.py:Own {SHORT} -o own.mcap", success=True),
        Typed(f"trial --controller own.py:Own --set share=9 {SHORT} -o b.mcap", 2),
        Typed("sweep --grid controller=own.py:Own,none --grid controller.share=0.95,1.05 --grid cycles=1 "
              "--grid settle=0 --workers 1 -o sweep.csv"), Typed("compare sweep.csv --controllers"),
        Typed(LONG_SWEEP, 130, ctrl_c="long.csv"), Typed(LONG_SWEEP))),
    "can": (_cut_logs, (
        Typed("node scan", success=True), Typed("node read 1 0x1018:1"), Typed("node scna", 2),
        Typed(f"trial {SHORT} -o bus.mcap"), Typed("export bus.mcap -o bus.log"), Typed("info bus.log"),
        Typed("replay bus.mcap --onto bus"), Typed("import short.asc -o short.mcap"),
        Typed("monitor short.asc --table"),
        Typed("import broken.asc -o broken.mcap", 2), Typed("import short.log -o log.mcap"))),
    "months": (lambda: None, (
        Typed("logbook init leg"), Typed(f"trial {SHORT} --day 0 --logbook leg -o 0.mcap"),
        Typed(f"trial {SHORT} --day 1 --logbook leg -o 1.mcap", success=True), Typed("logbook show leg"),
        Typed("logbook report leg -o leg.html"))),
    "bench": (_worn, (
        Typed("init --shape bench_two_legs -o bench.toml"), Typed("check config bench.toml"),
        Typed(f"trial --config bench.toml {SHORT} -o legs.mcap", success=True),
        Typed("report legs.mcap -o legs.html"), Typed("diagnose legs.mcap", 2),
        Typed(f"verify worn.toml --path right --config bench.toml {SHORT} -o verified.mcap"))),
    "rig": (_axis, (
        Typed("info worn.csv"), Typed("diagnose worn.csv", 2),
        Typed("diagnose worn.csv --healthy good.csv --healthy good2.csv --report worn.html", success=True),
        Typed("fit good.csv good2.csv -o axis.toml"))),
}
"""Users by name: a function that writes their files, and their commands."""


def _ran(one: Typed) -> tuple[int, str, str]:
    """Run one command in a separate process group, so that Ctrl-C reaches it alone; return status and outputs."""
    began = subprocess.Popen([*BOWDEN, *one.words.split()], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                             start_new_session=True)
    if one.ctrl_c:
        while began.poll() is None and not Path(one.ctrl_c).exists():
            time.sleep(0.1)
        os.killpg(began.pid, signal.SIGINT)
    out, err = began.communicate()
    return began.returncode, out, err


def walk(name: str) -> bool:
    """Run one user's commands in an empty folder and print their messages; return whether all ended as expected."""
    prepare, commands = USERS[name]
    prepare()
    began, first, good = time.monotonic(), None, True
    for one in commands:
        at = time.monotonic()
        status, out, err = _ran(one)
        messages = [*err.splitlines(), *out.splitlines()]
        expected = status == one.status and "Traceback" not in err and "Error in" not in err
        good &= expected
        if one.success and expected and first is None:
            first = time.monotonic() - began
        print(f"  {'' if expected else 'NOT EXPECTED '}{time.monotonic() - at:5.1f} s, {status}: "
              f"bowden {one.words}")
        print("".join(f"           {line}\n" for line in messages), end="", flush=True)
    print(f"{name}: first success after {'no time: none' if first is None else f'{first:.1f} s'}\n", flush=True)
    return good and first is not None


def main() -> int:
    """Run the commands of the named users, or of all."""
    asked = argparse.ArgumentParser(description=__doc__)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # else, begun in the background, commands ignore it
    asked.add_argument("--user", nargs="*", default=list(USERS), choices=list(USERS))
    good = True
    for name in asked.parse_args().user:
        with tempfile.TemporaryDirectory(prefix="walk-") as folder:
            os.chdir(folder)
            good &= walk(name)
            os.chdir("/")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
