"""What people expect of a command line, typed: version, short help, exit statuses, and that nothing misleads."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import can
import pytest

import trial
from bowden.cli.app import run
from bowden.cli.ending import as_ctrl_c
from tests.bowden.test_bowden_help import names
from trial.recover import recover

Bowden = Callable[..., tuple[int, str, str]]
BOWDEN = [sys.executable, "-c", "from bowden.cli import main; main()"]
SHORT = ("--cycles", "2", "--settle", "0", "--period", "1.0")


def made(path: Path) -> Path:
    recorder = trial.Recorder(path, metadata={}, attachments={}, threaded=False)
    for row in range(50):
        recorder.cycle(row * 1_000_000, [row / 1000, *[1.0] * (len(trial.SIGNALS) - 1)])
    recorder.close({})
    return path


# ---- what is expected ----


def test_the_version_and_the_short_option_for_help(bowden: Bowden) -> None:
    status, out, err = bowden("--version")
    assert (status, err) == (0, "")
    assert re.fullmatch(r"bowden \d+\.\d+\.\d+\S*\n", out)
    assert bowden("trial", "-h")[1] == bowden("trial", "--help")[1]


NEED_NOTHING = {("home",), ("release",), ("doctor",), ("init",), ("acknowledge",), ("monitor",), ("node", "scan"),
                ("lss", "scan"), ("lss", "store")}
"""Commands that do all they do without an argument, so that it is no mistake to give none."""


@pytest.mark.parametrize("command", sorted({*names(), ("node",), ("check",)} - NEED_NOTHING), ids=" ".join)
def test_a_command_that_is_given_nothing_tells_what_it_needs(
    here: Path, bowden: Bowden, command: tuple[str, ...]
) -> None:
    status, out, err = bowden(*command)
    assert (status, out) == (2, "")
    first, does, *_, last = err.splitlines()
    path = f"bowden {' '.join(command)}"
    assert re.fullmatch(rf"{path} [-A-Za-z_.…: |]+", first)
    assert does.startswith("  ")
    assert does.endswith(".")
    assert last == f"{path} --help lists its {'options' if 'Example: bowden' in err else 'commands'}."
    assert err.count("\n") <= 5
    assert os.listdir() == []


@pytest.mark.parametrize("command", sorted(names()), ids=" ".join)
def test_arguments_are_shown_as_words(bowden: Bowden, command: tuple[str, ...]) -> None:
    told = bowden(*command, "--help")[1]
    usage = re.sub(r"\s+", " ", told.partition("\n\n")[0])
    assert re.fullmatch(rf"Usage: bowden {' '.join(command)} \[OPTIONS\]( \[?[A-Z]+\]?(\.\.\.)?)*", usage)
    listed = told.partition("Arguments:\n")[2].partition("\n\n")[0]
    assert all(re.match(r"  [A-Z]+  +\S|    +\S", line) for line in listed.splitlines()), listed
    assert "<" not in listed


@pytest.mark.parametrize("columns", [
    60, *(pytest.param(columns, marks=pytest.mark.exhaustive) for columns in (80, 120))])
def test_summaries_are_not_cut_and_no_line_is_wider_than_the_terminal(
    columns: int, bowden: Bowden, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    for command in ((), ("node",), ("check",), *names()):
        told = bowden(*command, "--help")[1].splitlines()
        assert max(map(len, told)) <= columns, command
        assert not [line for line in told if line.endswith("...") and not line.startswith("Usage:")], command


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_names_the_commands(shell: str) -> None:
    asked = {"_BOWDEN_COMPLETE": f"complete_{shell}", "COMP_WORDS": "bowden re", "COMP_CWORD": "1",
             "_TYPER_COMPLETE_ARGS": "bowden re", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    told = subprocess.run(BOWDEN, env={**os.environ, **asked}, capture_output=True, text=True, check=False).stdout
    assert {"replay", "record", "recover", "report"} <= set(re.findall(r"[a-z]+", told))


def test_help_spells_what_options_take_in_words(bowden: Bowden) -> None:
    for command in ("trial", "replay", "sweep", "bench", "live", "identify", "record", "diagnose"):
        options = bowden(command, "--help")[1].split("Options:")[1]
        assert not re.findall(r"(?m)^ +-.*<(?:str|float|int|path)[^>]*>", options), command


def test_help_is_as_wide_as_the_terminal(bowden: Bowden, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "140")
    wide = bowden("trial", "--help")[1]
    monkeypatch.setenv("COLUMNS", "70")
    narrow = bowden("trial", "--help")[1]
    assert 80 < max(map(len, wide.splitlines())) <= 140
    assert max(map(len, narrow.splitlines())) <= 70


HEAVY = {"numpy", "scipy", "numba", "can", "canopen", "matplotlib", "rich", "mcap", "zstandard", "pandas", "pyarrow"}


def test_help_imports_nothing_heavy() -> None:
    script = ("import sys; from bowden.cli.app import run; run(['--help']); "
              "print(' '.join({name.partition('.')[0] for name in sys.modules}), file=sys.stderr)")
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert not HEAVY & set(told.stderr.split())


def test_what_raises_unexpectedly_is_one_line_without_a_traceback(
    here: Path, bowden: Bowden, monkeypatch: pytest.MonkeyPatch
) -> None:
    (here / "broken.py").write_text("def create(*arguments, **options):\n    raise ZeroDivisionError('a plug-in')\n")
    monkeypatch.syspath_prepend(str(here))
    status, out, err = bowden("trial", *SHORT, "--plant", "broken:create", "-o", "a.mcap")
    assert (out, "Traceback" in err) == ("", False)
    assert status == 2
    assert "plant 'broken:create' raised ZeroDivisionError (a plug-in) when it was made" in err
    assert not (here / "a.mcap").exists()


LATER = """from physics.plant import create as own


class Later:
    def __init__(self, parameters, seed):
        self.within = own(parameters, seed)
        self.reset, self.truth = self.within.reset, self.within.truth

    def advance(self, until_ns, servo_nm, knee_nm):
        if until_ns > 300_000_000:
            raise RuntimeError("the valve is stuck")
        return self.within.advance(until_ns, servo_nm, knee_nm)
"""


def test_a_plant_that_raises_in_a_trial_is_named_and_ends_with_2(here: Path, bowden: Bowden) -> None:
    (here / "folder").mkdir()
    (here / "folder" / "later.py").write_text(LATER)
    status, out, err = bowden("trial", *SHORT, "--plant", "folder/later.py:Later", "-o", "a.mcap")
    assert (status, out, "Traceback" in err) == (2, "", False)
    assert "plant 'folder/later.py:Later' raised RuntimeError (the valve is stuck) at 0.3" in err
    assert "the valve is stuck" in (trial.open("a.failed.mcap").result or {})["stop_reason"]
    assert sorted(path.name for path in here.glob("*.mcap")) == ["a.failed.mcap", "a.failed.truth.mcap"]


def test_a_controller_is_found_by_the_path_of_its_file(here: Path, bowden: Bowden) -> None:
    (here / "own.py").write_text("from master.control.packaged import PaperController as Own\n")
    (here / "work").mkdir()
    for path, status, text in (("own.py:Own", 0, ""), ("none.py:Own", 2, "none.py is no file; give path/to/file.py:"),
                               ("own.py:Other", 2, "cannot be imported (AttributeError")):
        told = bowden("trial", *SHORT, "--controller", here / path, "-o", "a.mcap", "--overwrite")
        assert (told[0], text in told[2]) == (status, True), told[2]


def test_an_output_that_cannot_be_made_is_refused_at_once_by_its_own_name(here: Path, bowden: Bowden) -> None:
    status, out, err = bowden("trial", *SHORT, "-o", "/proc/x.mcap")
    assert (status, out) == (2, "")
    assert err.startswith("bowden: /proc/x.mcap: cannot be written")


@pytest.mark.parametrize("arguments", [
    ("trial", "-o", "."), ("import", "a.csv", "-o", "."), ("export", "a.mcap", "-o", "."),
    ("report", "a.mcap", "-o", "."),
    ("recover", "a.mcap", "-o", "."), ("cut", "a.mcap", "--to", "1", "-o", "."), ("init", "-o", "."),
    ("report", "a.mcap", "-o", "none/there.html"), ("export", "a.mcap", "-o", "/proc/nothing.csv"),
    ("sweep", "--grid", "peak=40", "-o", "."),
], ids=" ".join)
def test_a_place_that_cannot_be_written_is_one_sentence(here: Path, bowden: Bowden, arguments: tuple[str, ...]) -> None:
    made(here / "a.mcap")
    (here / "a.csv").write_text("time_s,tension_end_n\n0,1\n1,2\n")
    status, out, err = bowden(*arguments)
    assert (status, out) == (2, "")
    assert err.startswith("bowden: ")
    assert "Traceback" not in err


@pytest.mark.parametrize(("name", "text", "arguments", "says"), [
    ("own.toml", "rate_hz = 100\n", ("check", "config"),
     "rate_hz = 100 stands before the first table; write it below the [table] that it belongs to"),
    ("a.csv", "time_s,tension_end_n\n0,1\n", ("monitor",), "a.csv: is no CAN log of its ending; give .mcap"),
])
def test_a_file_of_another_kind_is_named_without_a_word_of_a_library(
    here: Path, bowden: Bowden, name: str, text: str, arguments: tuple[str, ...], says: str
) -> None:
    (here / name).write_text(text)
    status, out, err = bowden(*arguments, name)
    assert (status, out) == (2, "")
    assert says in err


# ---- never mislead ----


@pytest.mark.parametrize("arguments", [("--channel", "can0"), ("--option", "port=1")])
def test_a_channel_without_an_interface_runs_no_simulation(
    here: Path, bowden: Bowden, arguments: tuple[str, ...]
) -> None:
    for command in (("trial", "-o", "a.mcap"), ("home",), ("doctor",), ("identify", "all", "-o", "c.toml")):
        status, out, err = bowden(*command, *arguments)
        assert (status, out, err.count("\n")) == (2, "", 1), command
        assert "add --interface socketcan" in err
    assert os.listdir() == []


def test_a_simulated_trial_says_so_first_last_and_on_its_page(here: Path, bowden: Bowden) -> None:
    status, out, err = bowden("trial", *SHORT, "-o", "a.mcap")
    assert status == 0
    assert "SIMULATED bench, serial 1, day 0, seed 0" in err
    assert out.splitlines()[-1].endswith("SIMULATED")
    assert trial.open(here / "a.mcap").metadata["bus"] == "SIMULATED"
    assert bowden("report", "a.mcap", "-o", "a.html")[0] == 0
    assert "SIMULATED bench" in (here / "a.html").read_text()


def test_a_dry_run_is_not_held_against_the_paper(here: Path, bowden: Bowden) -> None:
    _, out, _ = bowden("trial", *SHORT, "--dry-run", "-o", "a.mcap")
    assert "2.53" not in out
    assert "< 1" not in out


INPUTS = {  # commands that write, with the input named as the output
    "export": ("export", "a.mcap", "-o", "a.mcap"), "import": ("import", "a.csv", "-o", "a.csv"),
    "report": ("report", "a.mcap", "-o", "a.mcap"), "diagnose": ("diagnose", "a.mcap", "--report", "a.mcap"),
    "diagnose -o": ("diagnose", "a.mcap", "--calibration", "c.toml", "-o", "c.toml"),
    "replay": ("replay", "a.mcap", "--onto", "plant", "-o", "a.mcap"),
    "cut": ("cut", "a.mcap", "--to", "1", "-o", "a.mcap"),
    "fit": ("fit", "c.toml", "-o", "c.toml"),
    "simulate": ("simulate", "a.csv", "-o", "a.csv"), "merge": ("merge", "a.mcap", "c.mcap", "-o", "a.mcap"),
    "trial": ("trial", "--config", "c.mcap", "-o", "c.mcap"), "recover": ("recover", "a.mcap", "-o", "a.mcap"),
    "identify": ("identify", "all", "--from", "a.mcap", "--calibration", "c.toml", "-o", "c.toml"),
}


@pytest.mark.parametrize("case", INPUTS)
@pytest.mark.parametrize("linked", [False, True])
def test_an_output_that_is_an_input_is_refused_by_whatever_name(
    here: Path, bowden: Bowden, case: str, linked: bool
) -> None:
    made(here / "a.mcap")
    (here / "a.csv").write_text("time_s,tension_end_n\n0,1\n1,2\n")
    (here / "c.toml").write_text("")
    (here / "c.mcap").write_text("")
    before = {path.name: path.read_bytes() for path in here.iterdir()}
    *command, output = INPUTS[case]
    if linked:
        other = f"link{Path(output).suffix}"
        os.link(output, other)
        before[other] = before[output]
        output = other
    status, out, err = bowden(*command, output, "--overwrite")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "itself" in err
    assert {path.name: path.read_bytes() for path in here.iterdir()} == before


@pytest.mark.parametrize("arguments", [
    ("trial", "-o", "x.csv"), ("trial", "-o", "a.mcap", "--picture", "x.txt"), ("report", "a.mcap", "-o", "r.pdf"),
    ("diagnose", "a.mcap", "--report", "r.pdf"), ("diagnose", "a.mcap", "-o", "x.mcap"),
    ("replay", "a.mcap", "--onto", "plant", "-o", "x.csv"), ("sweep", "--grid", "peak=20", "-o", "x.mcap"),
    ("import", "a.csv", "-o", "x.csv"), ("import", "a.csv", "--guess", "-o", "x.csv"), ("init", "-o", "x.mcap"),
    ("recover", "a.mcap", "-o", "x.csv"), ("cut", "a.mcap", "--to", "1", "-o", "x.csv"),
    ("merge", "a.mcap", "a.mcap", "-o", "x.csv"), ("record", "--interface", "virtual", "-o", "x.csv"),
    ("verify", "e.toml", "-o", "x.csv"), ("compare", "a.mcap", "a.mcap", "--report", "x.pdf"),
    ("fit", "a.mcap", "-o", "x.csv"), ("simulate", "a.mcap", "-o", "x.toml"),
    ("node", "backup", "servo", "-o", "x.csv"),
    ("identify", "all", "-o", "x.csv"), ("identify", "all", "-o", "c.toml", "--picture", "x.xyz"),
], ids=" ".join)
def test_an_ending_that_contradicts_the_format_is_refused_before_anything_runs(
    here: Path, bowden: Bowden, arguments: tuple[str, ...]
) -> None:
    present = {made(here / "a.mcap").name}
    (here / "a.csv").write_text("time_s,tension_end_n\n0,1\n1,2\n")
    (here / "e.toml").write_text("[effects.end_offset]\noffset_n = 1.0\n")
    present |= {"a.csv", "e.toml"}
    status, out, err = bowden(*arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "written as" in err
    assert set(os.listdir()) == present


@pytest.mark.parametrize(("arguments", "said"), [
    (("servo", "--by", "400"), "is further than the axis can go"),
    (("knee", "--by", "-500"), "is further than the axis can go"),
    (("knee", "--by", "60"), "limits.knee_low_rad and knee_high_rad allow"),
])
def test_a_jog_beyond_limits_moves_nothing(bowden: Bowden, arguments: tuple[str, ...], said: str) -> None:
    status, out, err = bowden("jog", *arguments, "--speed", "50")
    assert status in (1, 2)
    assert said in out + err


def test_a_jog_that_tightens_the_rope_stops_and_says_where(bowden: Bowden) -> None:
    status, out, _ = bowden("jog", "servo", "--by", "100", "--speed", "100", "--json")
    told = json.loads(out)
    assert (status, told["outcome"]) == (1, "stopped")
    assert re.search(r"START reached \d+\.\d N with servo at .* mm, .* mm of 100.0 mm done", told["stop_reason"])


def test_a_refused_bring_up_leaves_nothing_that_makes_the_retry_fail(here: Path, bowden: Bowden) -> None:
    (here / "bench.toml").write_text("")
    with can.Bus("refused", interface="virtual"):
        arguments = ("trial", *SHORT, "--interface", "virtual", "--channel", "refused", "-o", "a.mcap")
        for _ in range(2):  # nobody answers there
            status, out, _ = bowden(*arguments)
            assert status == 1
            assert "nothing was recorded" in out
            assert "RMSE" not in out
    assert os.listdir() == ["bench.toml"]


ENDINGS = (pytest.param(signal.SIGINT, marks=pytest.mark.exhaustive), signal.SIGTERM,
           pytest.param(signal.SIGHUP, marks=pytest.mark.exhaustive))


def older_trial(folder: Path) -> dict[str, bytes]:
    """Write stand-ins for an older trial and its truth; return their content by name."""
    content = {"a.mcap": b"older trial", "a.truth.mcap": b"older truth"}
    for name, data in content.items():
        (folder / name).write_bytes(data)
    return content


@pytest.mark.parametrize("cause", ["no servo", "silent bus", "refused option"])
def test_overwrite_keeps_the_older_trial_where_the_new_one_does_not_begin(
        here: Path, bowden: Bowden, cause: str) -> None:
    (here / "faults.toml").write_text('[[fault]]\nkind = "power_off"\nnode = 1\nstart_s = 0.0\nstop_s = 1e3\n')
    bus = {"no servo": ("--interface", "bowden", "--option", "faults=faults.toml"),
           "silent bus": ("--interface", "virtual", "--channel", "nobody"),
           "refused option": ("--interface", "bowden", "--option", "hand=nothing")}[cause]
    before = older_trial(here)
    status, out, _ = bowden("trial", *SHORT, *bus, "-o", "a.mcap", "--overwrite")
    assert status in (1, 2)
    assert "Trial:" not in out
    assert {path.name: path.read_bytes() for path in here.glob("**/*.mcap")} == before
    assert sorted(os.listdir()) == ["a.mcap", "a.truth.mcap", "faults.toml"]


@pytest.mark.parametrize("options", [(), ("--watch", "--healthy", "h.mcap")], ids=["", "watched"])
def test_overwrite_keeps_the_older_trial_where_homing_stops_and_records_the_stop(
        here: Path, bowden: Bowden, options: tuple[str, ...]) -> None:
    (here / "faults.toml").write_text('[[fault]]\nkind = "emergency_stop"\nnode = 1\nstart_s = 0.0\n')
    if options:
        assert bowden("trial", *SHORT, "-o", "h.mcap")[0] == 0
    before = older_trial(here)
    status, out, err = bowden("trial", *SHORT, "--interface", "bowden", "--option", "faults=faults.toml", *options,
                              "-o", "a.mcap", "--overwrite")
    assert status == 1, err
    assert "Trial: a.failed.mcap" in out
    assert "emergency stop (STO)" in (trial.open("a.failed.mcap").result or {})["stop_reason"]
    assert {name: (here / name).read_bytes() for name in before} == before


@pytest.mark.parametrize("number", ENDINGS)
def test_overwrite_keeps_the_older_trial_where_a_signal_comes_before_the_new_one(
        here: Path, number: signal.Signals) -> None:
    before = older_trial(here)
    process = subprocess.Popen([*BOWDEN, "trial", *SHORT, "--interface", "virtual", "--channel", "nobody", "-o",
                                "a.mcap", "--overwrite"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        assert any(line.startswith("bowden: bench on") for line in process.stderr)  # the bus is open
        process.send_signal(number)
        rest = process.communicate(timeout=120.0)[1]
    finally:
        process.kill()
    assert process.returncode in (1, 128 + number), rest  # 1: it had given up before the signal came
    assert {path.name: path.read_bytes() for path in here.iterdir()} == before


def test_overwrite_replaces_the_older_trial_and_leaves_nothing_of_it(here: Path, bowden: Bowden) -> None:
    before = older_trial(here)
    assert bowden("trial", *SHORT, "-o", "a.mcap", "--overwrite")[0] == 0
    assert sorted(os.listdir()) == sorted(before)
    assert trial.open("a.mcap").result is not None


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_does_what_ctrl_c_does_and_its_number_is_the_status(number: signal.Signals) -> None:
    with pytest.raises(KeyboardInterrupt), as_ctrl_c() as ended:
        signal.raise_signal(number)
    assert ended.status(130) == 128 + number
    assert ended.status(0) == 0


STOPPED = """
import os, signal, sys
from bowden import progress
from bowden.cli import terminal
from bowden.cli.app import run
done = []
def telling(self, text):
    from contextlib import contextmanager
    @contextmanager
    def inside():
        yield reached
    def reached(share, step=""):
        if share > 0.2 and not done:
            done.append(1)
            os.kill(os.getpid(), int(sys.argv[1]))
    return inside()
terminal.Terminal.running = telling
sys.exit(run([*sys.argv[2:], "--json"]))
"""


def stopped(number: signal.Signals, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command that is sent a signal when a fifth of it is done; it ends by itself with 128 and the number."""
    ended = subprocess.run([sys.executable, "-c", STOPPED, str(int(number)), *arguments], capture_output=True,
                           text=True, check=False)
    assert ended.returncode == 128 + number, ended.stderr
    assert "Traceback" not in ended.stderr
    return ended


@pytest.mark.parametrize("number", ENDINGS)
def test_a_trial_that_is_told_to_end_stops_safely_with_its_file_whole(here: Path, number: signal.Signals) -> None:
    ended = stopped(number, "trial", "--cycles", "3", "--period", "1.0", "-o", "a.mcap")
    told = json.loads(ended.stdout)
    assert told["outcome"] == "stopped"
    assert told["stop_reason"].startswith("interrupted")
    opened = trial.open(here / "a.mcap")
    assert (opened.result or {})["outcome"] == "stopped"
    assert opened.columns["servo_position_m"][-1] < opened.columns["servo_position_m"].max()  # rope was paid out


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", ENDINGS)
def test_an_identification_that_is_told_to_end_writes_no_calibration(here: Path, number: signal.Signals) -> None:
    ended = stopped(number, "identify", "all", "-o", "c.toml")
    told = json.loads(ended.stdout)
    assert told["outcome"] == "stopped"
    assert told["stop_reason"].startswith("interrupted")
    assert not (here / "c.toml").exists()
    recording, = here.glob("*.mcap")
    assert (trial.open(recording).result or {})["reason"].startswith("interrupted")


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", ENDINGS)
def test_a_sweep_that_is_told_to_end_goes_on_from_there(here: Path, number: signal.Signals) -> None:
    sweep = ("sweep", "--grid", "peak=20,25,30", "--grid", "cycles=1", "--grid", "settle=0", "--grid",
             "period=1.1", "--workers", "1", "-o", "t.csv")
    ended = stopped(number, *sweep)
    assert "goes on from there" in ended.stderr
    assert len((here / "t.csv").read_text().splitlines()) < 1 + 3
    again = subprocess.run([*BOWDEN, *sweep, "--json"], capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert "trials are there from before" in again.stderr
    assert len((here / "t.csv").read_text().splitlines()) == 1 + 3


@pytest.mark.walltime
@pytest.mark.parametrize("number", ENDINGS)
@pytest.mark.parametrize("command", [("bench", "--interface", "virtual", "--channel", "endings"),
                                     ("live", "a.mcap", "--web", "0"),
                                     ("record", "--interface", "virtual", "--channel", "endings", "-o", "b.mcap")],
                         ids=" ".join)
@pytest.mark.slow
def test_what_serves_or_listens_ends_on_a_signal(here: Path, command: tuple[str, ...], number: signal.Signals) -> None:
    made(here / "a.mcap")
    process = subprocess.Popen([*BOWDEN, *command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline()  # it says where it is, and from then on it runs
        process.send_signal(number)
        rest = process.communicate(timeout=120.0)[0]
    finally:
        process.kill()
    assert process.returncode == 128 + number, rest
    assert "Traceback" not in rest
    assert command[0] != "record" or trial.open(here / "b.mcap").result is not None  # whole, and closed


def test_replay_after_recovery_compares_up_to_the_last_whole_cycle(here: Path, bowden: Bowden) -> None:
    assert bowden("trial", *SHORT, "-o", "a.mcap")[0] == 0
    whole = (here / "a.mcap").read_bytes()
    (here / "torn.mcap").write_bytes(whole[:int(len(whole) * 0.9)])
    recover(here / "torn.mcap", here / "back.mcap")
    status, out, err = bowden("replay", "back.mcap", "--onto", "controller")
    assert (status, err) == (0, "")
    assert "survived" in out


def test_replay_of_an_imported_log_says_what_it_can_be_replayed_onto(here: Path, bowden: Bowden) -> None:
    (here / "bus.log").write_text("".join(f"(1.{k:06}) can0 080#\n" for k in range(0, 9000, 1000)))
    assert bowden("import", "bus.log", "-o", "bus.mcap")[0] == 0
    for onto in ("controller", "plant"):
        status, _, err = bowden("replay", "bus.mcap", "--onto", onto)
        assert status == 2
        assert "--onto bus" in err, err


def test_the_commands_run_in_this_process_leave_signals_as_they_were() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    run(["--help"])
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before
