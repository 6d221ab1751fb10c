"""Surfaces that anybody may feed anything: one input each, made from a number, and what may come of it.

The rule of this file: an input is a pure function of (surface, number), so that a number is a regression; a surface
answers, or refuses with `InputError`; anything else that it raises is a finding.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import random
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from eds import dictionary
from eds.bench.bench_network import Network, wire
from eds.cia301 import Frame
from nodes import build
from parameters import InputError

STEP_NS: Final = 200_000
BURST: Final = 250
"""Frames of one input of the device surfaces: enough to reach a mapping, a transfer or a state."""
NUMBERS: Final = ("0", "-1", "1e400", "nan", "9" * 40, "0x", "", "1,5", "true", "'", '"', "[", "]", "=", "\0", "é", "…")


def chance_of(surface: str, number: int) -> random.Random:
    """The stream of chance that makes this input."""
    return random.Random(zlib.crc32(surface.encode()) << 40 | number)


def mutated(chance: random.Random, seed: bytes, most: int = 6) -> bytes:
    """A few bytes changed, inserted, removed, repeated, or the end torn off."""
    data = bytearray(seed)
    for _ in range(chance.randrange(1, most + 1)):
        at, kind = chance.randrange(len(data) + 1), chance.randrange(7)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << chance.randrange(8)
        elif kind == 1:
            data[at:at] = chance.randbytes(chance.randrange(1, 9))
        elif kind == 2:
            del data[at:at + chance.randrange(1, 33)]
        elif kind == 3:
            data[at:at] = data[at:at + chance.randrange(1, 65)]
        elif kind == 4:
            data[at:at] = chance.choice(NUMBERS).encode()
        elif kind == 5 and chance.random() < 0.3:
            del data[at:]
        else:
            data[at:at + 4] = chance.choice((b"\0\0\0\0", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\1\0\0\0"))
    return bytes(data)


# ---- devices ----


@functools.cache
def _network() -> Any:
    return wire(Network())


def _device(node_id: int) -> Any:
    device, _application = build(node_id, _network())
    device.power_on(0)
    device.outbox.clear()
    return device


def device(chance: random.Random) -> None:
    """Any frames, of any kind and length, to one of the four devices while its time goes on."""
    node_id = chance.randrange(1, 5)
    under_test, now_ns = _device(node_id), 0
    for _ in range(BURST):
        now_ns += chance.randrange(STEP_NS)
        near = (0, 0x80, 0x200 + node_id, 0x201, 0x300 + node_id, 0x301, 0x183, 0x600 + node_id, 0x77F, 0x7E5)
        can_id = chance.choice(near) if chance.random() < 0.9 else chance.randrange(0x800)
        data = chance.randbytes(chance.randrange(9))
        under_test.receive(Frame(can_id, data, remote=chance.random() < 0.05, extended=chance.random() < 0.05), now_ns)
        _run(under_test, now_ns)


def sdo(chance: random.Random) -> None:
    """Any sequence of SDO frames about any object, segments and blocks among them."""
    node_id = chance.randrange(1, 5)
    under_test, now_ns = _device(node_id), 0
    entries = _entries(node_id)
    for _ in range(BURST):
        now_ns += chance.randrange(STEP_NS)
        at = chance.choice(entries) if chance.random() < 0.9 else chance.randrange(1 << 24)
        start = chance.choice((0x20, 0x21, 0x22, 0x23, 0x27, 0x2B, 0x2F, 0x40, 0x60, 0x70, 0x80, 0xA0, 0xA1, 0xA3, 0xC0,
                               0xC2, 0xC6, 0x00, 0x10, chance.randrange(256)))
        head = bytes((start, at >> 8 & 0xFF, at >> 16, at & 0xFF))
        data = (head + chance.randbytes(4))[:8 if chance.random() < 0.97 else chance.randrange(9)]
        under_test.receive(Frame(0x600 + node_id, data), now_ns)
        _run(under_test, now_ns)
        answers = sum(frame.can_id == 0x580 + node_id for frame in under_test.outbox)
        assert answers <= 127, f"{answers} answers to one frame"
        under_test.outbox.clear()


@functools.cache
def _entries(node_id: int) -> list[int]:
    return sorted(_network().nodes[node_id].dictionary.entries)


def _run(under_test: Any, now_ns: int) -> None:
    """Let the device do what it has due, as a bus does."""
    for _ in range(200):
        due_ns = under_test.next_ns()
        if due_ns is None or due_ns > now_ns:
            break
        under_test.poll(now_ns)
    else:
        raise AssertionError("the device is never done")
    for frame in under_test.outbox:
        assert len(frame.data) <= 8, frame
        assert 0 <= frame.can_id <= 0x7FF, frame


# ---- files ----


@functools.cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="fuzz-"))


@functools.cache
def _seed_trial() -> bytes:
    """A small whole trial: table, frames, events, attachments."""
    from trial.record import Recorder
    from trial.signals import COLUMNS

    path = _folder() / f"seed-{os.getpid()}.mcap"
    recorder = Recorder(path, metadata={"rate_hz": "1000"}, attachments={"calibration.toml": b"version = 1\n"},
                        threaded=False, overwrite=True)
    for cycle in range(60):
        time_ns = 1_000_000 * cycle
        recorder.frame(time_ns, 0x080, b"")
        recorder.frame(time_ns + 100_000, 0x183, b"\1\2")
        recorder.cycle(time_ns, [float(cycle)] * len(COLUMNS))
    recorder.event(1_000_000, "nmt", "servo", "OPERATIONAL.")
    recorder.close({"outcome": "completed"})
    return path.read_bytes()


def _written(name: str, data: bytes) -> Path:
    path = _folder() / f"{os.getpid()}-{name}"
    path.write_bytes(data)
    return path


def mcap(chance: random.Random) -> None:
    """A trial with bytes changed: read, and recovered."""
    from trial import read
    from trial.recover import recover

    path = _written("torn.mcap", mutated(chance, _seed_trial()))
    with contextlib.suppress(InputError):
        trial = read.open(path)
        trial.frames, trial.events, trial.columns  # noqa: B018 — reading is what is tried
    with contextlib.suppress(InputError):
        recover(path, _folder() / f"{os.getpid()}-mended.mcap", overwrite=True)


def eds(chance: random.Random) -> None:
    """An EDS with bytes changed."""
    name = chance.choice(("servo_drive", "knee_drive", "tension_sensor"))
    with contextlib.suppress(InputError):
        dictionary.read(_written("device.eds", mutated(chance, _section_of(name, chance))), 1)


@functools.cache
def _sections(name: str) -> list[bytes]:
    text = dictionary.packaged(name).read_bytes()
    return [b"[" + part for part in text.split(b"\n[")]


def _section_of(name: str, chance: random.Random) -> bytes:
    """The first sections and some of the rest: an EDS small enough to try many."""
    sections = _sections(name)
    return b"\n".join(sections[:6] + chance.sample(sections[6:], 12))


def csv(chance: random.Random) -> None:
    """A table with bytes changed, imported."""
    rows = "".join(f"{n * 1e-3:.3f},{n % 100},{20.0 + n % 7:.2f},{18.5:.2f},-0.{n % 10}\n" for n in range(12))
    text = f"time_s,gait_percent,tension_start_n,tension_end_n,knee_angle_rad\n{rows}".encode()
    _import(f"table.{chance.choice(('csv', 'csv', 'csv.gz'))}", mutated(chance, text))


LOGS: Final = {
    "log": b"".join(b"(%d.%06d) can0 %03X#%s\n" % (1700000000 + n // 9, 1000 * n, 0x181 + n % 4, b"0102030405060708"[
        :2 * (n % 9)]) for n in range(24)),
    "asc": b"date Mon Nov 20 10:00:00 2023\nbase hex  timestamps absolute\n" + b"".join(
        b"   %d.%06d 1  %X             Rx   d 2 01 02\n" % (n, n, 0x181 + n % 4) for n in range(12)),
    "trc": b";$FILEVERSION=1.1\n;$STARTTIME=45000.5\n" + b"".join(
        b"%6d) %10d.1  Rx         %04X  2  01 02\n" % (n + 1, n, 0x181 + n % 4) for n in range(12)),
    "blf": b"LOGG" + bytes(140),
}


def log(chance: random.Random) -> None:
    """A CAN log of one of four formats with bytes changed, imported."""
    ending = chance.choice(sorted(LOGS))
    _import(f"bus.{ending}", mutated(chance, LOGS[ending]))


def _import(name: str, data: bytes) -> None:
    from trial.convert.imports import import_file

    with contextlib.suppress(InputError):
        import_file(_written(name, data), _folder() / f"{os.getpid()}-made.mcap", overwrite=True)


@functools.cache
def _tables() -> list[tuple[bytes, Callable[[Path], Any]]]:
    from bowden.bench import configuration
    from eds.declaration import PathNodes
    from physics import calibration, older_files
    from virtual_bus.machine import plant_model
    from virtual_bus.wire import faults

    declared = calibration.nominal()
    lines = [f"version = {older_files.VERSION}"]
    lines += [f"[{name}]\nvalue = {getattr(declared, name)!r}" for name in calibration.scalars()]
    return [
        (configuration.as_text(configuration.read(None)).encode(), configuration.read),
        ("\n".join(lines).encode(), calibration.read),
        (b"[plant]\nmu1 = 0.1\n[effects.end_offset]\noffset_n = 2.0\n[bus]\nlate_s = 0.001\n",
         functools.partial(plant_model.read, nodes=PathNodes(1, 2, 3, 4))),
        (b'[[fault]]\nkind = "drop"\ncob_id = 0x183\nstart_s = 1.0\nprobability = 0.5\n', faults.declared),
    ]


def toml(chance: random.Random) -> None:
    """A configuration, calibration, plant model or list of faults with bytes changed."""
    text, read = chance.choice(_tables())
    with contextlib.suppress(InputError):
        read(_written("given.toml", mutated(chance, text)))


WORDS: Final = (
    "trial", "bench", "home", "tare", "jog", "release", "identify", "replay", "import", "export", "diagnose", "fit",
    "simulate", "record", "info", "cut", "merge", "report", "verify", "compare", "live", "check", "config", "eds",
    "recover", "sweep", "doctor", "init", "acknowledge", "node", "--help", "--json", "-o", "--peak", "--period",
    "--cycles", "--settle", "--rate", "--config", "--calibration", "--serial", "--day", "--seed", "--plant", "--option",
    "--interface", "--channel", "--controller", "--controller-model", "--dry-run", "--overwrite", "--onto", "--",
    "--experiment", "--knee", "--desired", "none.mcap", "none.toml", "none.csv", "/", ".", "socketcan", "paper")
HARMLESS: Final = ("--help", "none.mcap")


def command(chance: random.Random) -> None:
    """A command line of words that the program knows, and of some that it does not: exit status 0, 1 or 2."""
    from bowden.cli.app import run

    words = [chance.choice(WORDS) if chance.random() < 0.8 else mutated(chance, chance.choice(WORDS).encode()).decode(
        "utf-8", "replace").replace("\0", "") for _ in range(chance.randrange(1, 7))]
    words.insert(chance.randrange(len(words) + 1), chance.choice(HARMLESS))  # nothing that runs for long gets through
    if words[0] in ("bench", "trial", "live", "sweep", "record", "home", "tare", "jog", "release", "identify", "doctor",
                    "init", "acknowledge") and "--help" not in words:
        words.append("--no-such-option")
    status = 0
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()), _elsewhere():
        status = run(words)
    assert status in (0, 1, 2), (status, words)
    assert status != 2 or not out.getvalue() or words[0] == "diagnose", (words, out.getvalue()[:200])


@contextlib.contextmanager
def _elsewhere() -> Iterator[None]:
    """In an empty folder: what a command writes stays there."""
    before = Path.cwd()
    os.chdir(_folder())
    try:
        yield
    finally:
        os.chdir(before)


SURFACES: Final[dict[str, Callable[[random.Random], None]]] = {
    "device": device, "sdo": sdo, "mcap": mcap, "eds": eds, "csv": csv, "log": log, "toml": toml, "command": command}
