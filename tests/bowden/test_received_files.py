"""Received files: bounded memory and time whatever they declare, and no path outside the recording."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bowden.bench import configuration
from bowden.trials import recorded
from parameters import InputError
from trial.read import open as opened
from trial.record import Recorder

ROOT = Path(__file__).parents[2]
MEMORY, SECONDS = 256 << 20, 10.0
"""Memory, bytes, and processor time, s, that a reader may take beyond what it takes for an empty file."""
IN_BOUNDS = """
import resource, sys, time
from pathlib import Path
from tests.bowden.test_received_files import READERS
from parameters import InputError
read = READERS[sys.argv[1]]
for name in sys.argv[2:]:
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    try:
        read(Path(name))
    except InputError as error:
        print(error, file=sys.stderr)
    print(1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before), time.process_time() - began)
"""


def _bus_yml(path: Path) -> None:
    from eds.files import bus_yml

    content = bus_yml.read(path)
    bus_yml.text_of(content.content)
    _ = content.devices


def _imported(path: Path) -> None:
    from trial.convert.imports import import_file

    import_file(path, path.with_name("made.mcap"), overwrite=True)


def _trial(path: Path) -> None:
    trial = opened(path)
    _ = trial.frames, trial.events, trial.columns


def _eds(path: Path) -> None:
    from eds import dictionary

    dictionary.read(path, 1)


def _configuration(path: Path) -> None:
    configuration.read(path)


READERS: dict[str, Callable[[Path], None]] = {
    "yml": _bus_yml, "import": _imported, "mcap": _trial, "eds": _eds, "toml": _configuration}
EXPORTED = ("csv.gz", "xlsx", "parquet", "mat", "tdms", "mf4", "log", "blf", "asc", "trc")
"""Formats of `bowden export`, whose files `bowden import` reads."""
INPUTS = 20
"""Damaged files of one format."""


def seed_of(ending: str, folder: Path) -> tuple[str, bytes]:
    """Return the reader of a format and the bytes of a small file of it."""
    from eds.dictionary import packaged
    from tests.fuzz.surfaces import _seed_trial
    from trial.convert.export import export

    if ending == "mcap":
        return "mcap", _seed_trial()
    if ending == "yml":
        return "yml", ("master: {node_id: 1}\n" + nested(3)).encode()
    if ending == "eds":
        return "eds", packaged("knee_drive").read_bytes()[:20_000]
    if ending == "toml":
        return "toml", configuration.as_text(configuration.read(None)).encode()
    whole = folder / "seed.mcap"
    whole.write_bytes(_seed_trial())
    export(opened(whole), folder / f"seed.{ending}")
    return "import", (folder / f"seed.{ending}").read_bytes()


@pytest.mark.exhaustive
@pytest.mark.parametrize("ending", ["mcap", "yml", "eds", "toml", *EXPORTED])
def test_damaged_files_of_each_format_are_read_or_refused_within_bounds(tmp_path: Path, ending: str) -> None:
    from tests.fuzz.surfaces import chance_of, mutated

    reader, seed = seed_of(ending, tmp_path)
    files = [tmp_path / f"{number}.{ending}" for number in range(INPUTS)]
    files[0].write_bytes(seed)
    for number, file in enumerate(files[1:], 1):
        file.write_bytes(mutated(chance_of(f"bounds {ending}", number), seed))
    run = subprocess.run([sys.executable, "-c", IN_BOUNDS, reader, *map(str, files)], cwd=ROOT, capture_output=True,
                         text=True, check=False, timeout=400)
    assert run.returncode == 0, run.stderr[-2000:]
    for line in run.stdout.splitlines()[1:]:
        grown, cpu_s = line.split()
        assert int(grown) < MEMORY
        assert float(cpu_s) < SECONDS


def within_bounds(reader: str, harmless: Path, hostile: Path) -> str:
    """Read a harmless file, for what the libraries take, and a hostile one; return the sentence of its refusal."""
    run = subprocess.run([sys.executable, "-c", IN_BOUNDS, reader, str(harmless), str(hostile)], cwd=ROOT,
                         capture_output=True, text=True, check=False, timeout=100)
    assert run.returncode == 0, run.stderr
    grown, cpu_s = run.stdout.split()[2:]
    assert int(grown) < MEMORY
    assert float(cpu_s) < SECONDS
    return run.stderr.splitlines()[-1] if run.stderr else ""


def nested(levels: int, within: str = "[{}]") -> str:
    """Return YAML in which each of `levels` lists holds nine aliases of the list before it."""
    lines = ["l0: &l0 [1, 2, 3, 4, 5, 6, 7, 8, 9]"]
    lines += [f"l{n}: &l{n} " + within.format(", ".join([f"*l{n - 1}"] * 9)) for n in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize("text", [
    "master: {node_id: 1}\n" + nested(8),
    "master: {node_id: 1}\ndrive: {node_id: 2, other: &a [*a]}\n",
    "master: {node_id: 1}\ndefaults: &d0 {a: 1}\n" + "\n".join(
        f"m{n}: &d{n} {{<<: [{', '.join([f'*d{n - 1}'] * 9)}]}}" for n in range(1, 8)),
    f"master: {{node_id: {'9' * 5000}}}\n",
])
def test_a_bus_yml_of_aliases_is_refused_in_one_sentence(tmp_path: Path, text: str) -> None:
    harmless, hostile = tmp_path / "a.yml", tmp_path / "bus.yml"
    harmless.write_text("master: {node_id: 1}\n")
    hostile.write_text(text)
    assert "bus.yml: " in within_bounds("yml", harmless, hostile)


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.slow
def test_an_mf4_file_that_stands_for_gigabytes_is_refused(tmp_path: Path, slow: bool) -> None:
    """300 channels of zeros, or a hundred signals of two values beside a clock of three million."""
    asammdf = pytest.importorskip("asammdf")
    rows = 3_000_000 if slow else 400_000
    clock = np.arange(rows) * 1e-3

    def save(name: str, groups: list[Any]) -> Path:
        with asammdf.MDF(version="4.10") as file:
            for group in groups:
                file.append(group)
            file.save(tmp_path / name, compression=2, overwrite=True)
        return tmp_path / name

    def signal(name: str, values: Any, stamps: Any) -> Any:
        return asammdf.Signal(values, stamps, name=name, unit="N")

    small = save("small.mf4", [[signal("tension_start_n", np.zeros(9), np.arange(9.0))]])
    zeros = np.zeros(rows, np.uint8)
    bomb = save("bomb.mf4", [[signal("clock", zeros, clock)], *(
        [signal(f"s{n}", np.zeros(2), np.arange(2.0))] for n in range(100))] if slow else [
            [signal(f"s{n}", zeros, clock) for n in range(300)]])
    assert bomb.stat().st_size < 1 << 20
    assert "bomb.mf4: unpacks to more than" in within_bounds("import", small, bomb)


def test_a_zipped_mf4_block_that_holds_more_than_it_declares_is_refused(tmp_path: Path) -> None:
    import struct
    import zlib

    from trial.convert import sheets

    packed = zlib.compress(bytes(200 << 20), 9)
    head = struct.pack("<4s4xQQ2sBxIQQ", b"##DZ", 48 + len(packed), 0, b"DT", 0, 0, 1000, len(packed))
    (tmp_path / "lie.mf4").write_bytes(bytes(64) + head + packed)
    with pytest.raises(InputError, match=r"lie.mf4: unpacks to more than"):
        sheets.check_mdf_blocks(tmp_path / "lie.mf4")


def trial_with(tmp_path: Path, bench: str, **attached: bytes) -> Path:
    path = tmp_path / "received.mcap"
    recorder = Recorder(path, metadata={}, attachments={"bench.toml": bench.encode(), **attached}, threaded=False)
    recorder.close({})
    return path


@pytest.mark.parametrize("place", ["absolute", "above"])
def test_a_recording_names_no_file_outside_itself(tmp_path: Path, place: str) -> None:
    from tests.faults import bought_drive

    secret = bought_drive.write_eds(tmp_path)
    named = str(secret) if place == "absolute" else f"../{tmp_path.name}/{secret.name}"
    path = trial_with(tmp_path, f'[servo]\nfile = "{named}"\ntension = ""\n')
    with pytest.raises(InputError, match=r"received.mcap: its bench.toml names .* for servo, which is not attached"):
        recorded.sections(opened(path))


def test_a_recordings_monitor_has_the_attached_bounds_and_no_file_of_this_computer(tmp_path: Path) -> None:
    """A recording with a monitor could not be read at all; one that named a file elsewhere read that."""
    import safety_monitor

    content = safety_monitor.packaged().read_bytes().replace(b'"packaged"', b'"P-017"')
    secret = tmp_path / "elsewhere.toml"
    secret.write_bytes(content)
    for named in (str(secret), f"../{tmp_path.name}/{secret.name}", "packaged"):
        path = trial_with(tmp_path, f'[monitor]\nfile = "{named}"\n')
        with pytest.raises(InputError, match=r"names .* for the safety monitor, which is not attached"):
            recorded.sections(opened(path))
        path.unlink()
    path = trial_with(tmp_path, '[monitor]\nfile = "person.toml"\n', **{"person.toml": content})
    assert safety_monitor.read(Path(recorded.sections(opened(path))["network"].monitor)).person == "P-017"


def test_a_recordings_device_is_read_from_its_attachment(tmp_path: Path) -> None:
    """Wherever the operator's file was: the attached one is read, also after the trial is closed."""
    from eds.bench.bench_network import wire
    from tests.faults import bought_drive

    content = bought_drive.write_eds(tmp_path).read_bytes()
    (tmp_path / bought_drive.NAME).unlink()
    path = trial_with(tmp_path, f'[servo]\nfile = "/home/operator/{bought_drive.NAME}"\ntension = ""\n',
                      **{bought_drive.NAME: content})
    network = recorded.sections(opened(path))["network"]
    assert wire(network).nodes[1].dictionary.path.endswith(bought_drive.NAME)
