"""One control cycle of several force paths over one bus.

Each path has an `Exchange`, with its guard, plausibility and targets; the bus, SYNC, the frames of targets and the
row of `/cycle` are shared. A procedure of one path runs unchanged on that path's exchange. Meanwhile the other paths
hold, and a rope follows a joint that the other path of that joint moves.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Final, NamedTuple, TypeVar

import can

from eds.bench.bench_network import WireLayout
from eds.declaration import EXTENDS, MIRROR_RAD, ForcePath
from master.cycle.exchange import NAN, Exchange, SyncCycle
from master.cycle.guard import Guard
from master.cycle.inputs import KNEE, CycleAnnotations, Inputs
from master.cycle.log import Log
from master.cycle.safety import StopError
from master.network.link import Link
from physics.calibration import nominal
from trial.signals import joined

T = TypeVar("T")

ROPE_PER_KNEE: Final = nominal().rope_per_knee
"""Rope by angle, m/rad, by which the slack rope of a resting path goes along with its joint: the packaged lever."""


class Answer(NamedTuple):
    """Answer of a path to its inputs: targets, m and rad, and the step's entries in its row."""

    servo_m: float
    knee_rad: float
    annotations: CycleAnnotations | None = None


Work = Generator[Answer, None, T]
"""Procedure of one path: yields its answer in each cycle, and reads the inputs from its exchange."""


class PathExchange(Exchange):
    """The running cycle as one of several force paths sees it; its knee angle is the joint's as the path counts it."""

    alone = False

    def __init__(self, shared: SharedExchange, path: ForcePath, guard: Guard, budget_ns: int) -> None:
        super().__init__(shared.link, shared.wire.of_path(path.name), shared.log, guard, budget_ns)
        self.name, self.joint, self.mirrors = path.name, path.joint, path.acts == EXTENDS
        self._shared = shared
        if self.mirrors:
            self._unpack[KNEE] = _mirrored(self._unpack[KNEE])

    def mirrored(self, angle_rad: float) -> float:
        """Convert a knee angle, rad, between the counting of the joint and of the path; the conversion is its own
        inverse."""
        return MIRROR_RAD - angle_rad if self.mirrors else angle_rad

    def advance(self, servo_m: float, knee_rad: float, annotations: CycleAnnotations | None = None) -> Inputs:
        """Run one cycle in which this path goes on and the others hold."""
        self._shared.advance({self.name: Answer(servo_m, knee_rad, annotations)})
        return self.inputs

    def command(self, servo_word: int, knee_word: int) -> None:
        """Send the controlwords of this path's drives; other drives keep theirs."""
        self._shared.command({self.path.servo: servo_word, self.path.knee: knee_word})


class SharedExchange(SyncCycle):
    """The running cycle of all force paths; `paths` are their exchanges in declared order, `wire` the whole bench's.

    Counters, `begin` and `end` are as in `Exchange`.  The first path of a joint leads its drive.
    """

    def __init__(self, link: Link, wire: WireLayout, log: Log, guard_of: Callable[[WireLayout, ForcePath], Guard],
                 budget_ns: int) -> None:
        super().__init__(link, wire, log, budget_ns)
        self.paths: tuple[PathExchange, ...] = tuple(
            PathExchange(self, path, guard_of(wire.of_path(path.name), path), budget_ns)
            for path in wire.network.bench.force_paths)
        self._run_paths()
        self._of_joint = {path.name: [other for other in self.paths if other.joint == path.joint and other is not path]
                          for path in self.paths}
        frames = list(wire.master_frames())
        self._targets = [(plan, nodes) for name, plan, nodes in frames if name == "target"]
        self._controlwords = [(plan, nodes) for name, plan, nodes in frames if name == "controlword"]
        self._words = dict.fromkeys(wire.drives, 0)

    @property
    def missed_cycles(self) -> int:
        """Cycles whose inputs or targets came too late, of the path that missed most."""
        return max(path.missed_cycles for path in self.paths)

    @property
    def stale_inputs(self) -> int:
        """Number of PDOs older than a cycle that reached a step, of all paths."""
        return sum(path.stale_inputs for path in self.paths)

    def hold(self) -> None:
        """Run one cycle with the targets of the last one."""
        self.advance({})

    def command(self, words: Mapping[int, int]) -> None:
        """Send the controlwords of some drives, by node; the others keep theirs."""
        self._words.update({node: word for node, word in words.items() if node in self._words})
        for plan, nodes in self._controlwords:
            if any(node in words for node in nodes):
                self.link.send(plan.cob_id, plan.pack(*(self._words[node] for node in nodes)))

    def advance(self, answers: Mapping[str, Answer]) -> None:
        """Send each path its controller's answer, else its last targets; receive the inputs of the next SYNC.

        Raises `StopError` for a condition of safety's table, `LinkError` if the bus is gone.
        """
        led: dict[str, float] = {}
        for path in self.paths:
            if path.name in answers:
                led.setdefault(path.joint, path.mirrored(answers[path.name].knee_rad))
        told = []
        for path in self.paths:
            answer = self._answer(path, answers.get(path.name), led.get(path.joint))
            with _located(path):
                path.answer(*answer)
            told.append(answer.annotations or path.annotations)
        sent = self._send()
        sync_ns = self._await_sync()
        self.log.drain()
        self._record(told, self._in_time(sync_ns, sent))
        self._refuse_silence(sync_ns)
        self._latch(sync_ns)

    @staticmethod
    def _answer(path: PathExchange, given: Answer | None, joint_rad: float | None) -> Answer:
        """Return a path's answer when its joint is led to `joint_rad`; None if nothing leads the joint."""
        servo, knee = path.targets
        led = knee if joint_rad is None else path.mirrored(joint_rad)
        if given is None:
            return Answer(servo + ROPE_PER_KNEE * (led - knee), led)
        return given._replace(knee_rad=led)

    def _send(self) -> bool:
        """Send the frames of targets; return whether the bus accepted all of them."""
        targets: dict[int, float] = {}
        for path in self.paths:
            servo, knee = path.targets
            targets[path.path.servo] = servo
            targets.setdefault(path.path.knee, path.mirrored(knee))
        sent = True
        for plan, nodes in self._targets:
            data = plan.pack_si(*(targets[node] for node in nodes))
            if self.link.watch is not None:
                self.link.watch.sent(plan.cob_id, data)
            sent &= self.link.try_send(can.Message(arbitration_id=plan.cob_id, data=data, is_extended_id=False))
        return sent

    def _record(self, told: list[CycleAnnotations], sent: bool) -> None:
        for path in self.paths:
            path.note(sent)
        if self.paths[0].told:
            return
        self.paths[0].told = True
        rows = [path.row_of(annotations, sent) for path, annotations in zip(self.paths, told, strict=True)]
        own = [(*annotations.own, *(NAN,) * (path.own - len(annotations.own)))
               for path, annotations in zip(self.paths, told, strict=True)]
        self.log.row(self.paths[0].inputs.sync_ns, joined(rows, self.paths[0].observed, own))

    def _latch(self, sync_ns: int) -> None:
        """Collect the PDOs of one SYNC until they are all there or the deadline has come; then check every path."""
        for path in self.paths:
            path.begin_latch(sync_ns)
            path.expect()
        self._collect(sync_ns)
        for path in self.paths:
            path.latched(sync_ns)
        # all are latched before one is checked: a path is not compared while another one of its joint lacks inputs
        for path in self.paths:
            path.guard.joint_held = any(other.inputs.missing for other in self._of_joint[path.name])
        for path in self.paths:
            with _located(path):
                path.checked()


@contextmanager
def _located(path: PathExchange) -> Iterator[None]:
    """Let a stop that names a device of this force path name the path, too."""
    try:
        yield
    except StopError as stop:
        if not stop.node_id or stop.node_id not in path.path:
            raise
        raise StopError(stop.condition, f"{stop.detail} (force path {path.name})", stop.node_id) from stop


Running = Exchange | SharedExchange
"""The running cycle of a bench, of one force path or of several: `paths` has the exchange of each."""


def together(exchange: Running, works: Sequence[Work[T]]) -> list[T]:
    """Run a procedure of each path in the same cycles, and return what they return; a path that is done holds."""
    found: dict[int, T] = {}
    while True:
        answers: dict[int, Answer] = {}
        for i, work in enumerate(works):
            if i not in found:
                try:
                    answers[i] = next(work)
                except StopIteration as done:
                    found[i] = done.value
        if not answers:
            return [found[i] for i in range(len(works))]
        if isinstance(exchange, Exchange):
            exchange.advance(*answers[0])
        else:
            exchange.advance({exchange.paths[i].name: answer for i, answer in answers.items()})


def _mirrored(unpack: Callable[[bytes], tuple[float, ...]]) -> Callable[[bytes], tuple[float, ...]]:
    """Return a decoder of a knee drive's frame with the angle in the counting of an antagonist's path."""
    def read(data: bytes) -> tuple[float, ...]:
        status, angle = unpack(data)
        return status, MIRROR_RAD - angle

    return read
