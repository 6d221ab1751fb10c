"""The logbook through the command line: entries, crashes, a second process, moved files, changes over sessions.

Changes are shown on sessions drawn about one simulated bench with the accuracy of its own estimate.
"""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from bowden.cli.app import run
from estimation.linear_sums import SessionSums, Sums, effect_columns, linearisation_error, slopes, summed
from estimation.path_model import PATH_MODEL
from estimation.stored_fit import decoded
from logbook import database
from logbook.bench_state import CANNOT, CHANGED, CONSTANTS, SET_SHARE, UNCHANGED, Cause, constants_of, enter_cause
from logbook.database import NewTrial, open_logbook
from logbook.session_fits import recording_of
from physics.forward.path_constants import FREE, SESSION_SD

DAYS = 3
PUBLISHED = SESSION_SD[list(FREE)]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A logbook of three days of one simulated bench, entered by `bowden trial --logbook` and by `[record]`."""
    place = tmp_path_factory.mktemp("bench")
    assert run(["logbook", "init", str(place / "book"), "--name", "left leg", "--references", "2"]) == 0
    (place / "bench.toml").write_text('[record]\nlogbook = "book"\n', encoding="utf-8")
    for day in range(DAYS):
        how = ["--config", str(place / "bench.toml")] if day else ["--logbook", str(place / "book")]
        assert run(["trial", "--cycles", "3", "--period", "1.2", "--serial", "3", "--day", str(day), *how, "-o",
                    str(place / f"{day}.mcap"), "--json"]) == 0
    return place


def told(bowden: Callable[..., Any], *words: object) -> dict[str, Any]:
    """Return the JSON object of a command that ended with 0."""
    status, out, err = bowden(*words, "--json")
    assert status == 0, err
    found: dict[str, Any] = json.loads(out)
    return found


def test_every_day_is_a_session_with_constants(bench: Path, bowden: Callable[..., Any]) -> None:
    listed = told(bowden, "logbook", "list", bench / "book")
    assert [(row["label"], row["estimated"]) for row in listed["newest"]] == [
        (f"day {day}", True) for day in reversed(range(DAYS))]
    assert listed["newest"][0]["figures"]["relative_rmse_percent"] < 5.0
    shown = told(bowden, "logbook", "show", bench / "book", "--limit", "cable=0.5")
    assert shown["bench"] == "left leg"
    assert shown["reference_sessions"] == 2
    stiffness = shown["constants"]["stiffness"]
    assert stiffness["low"] < stiffness["value"] < stiffness["high"]
    assert shown["forecasts"][0]["sessions"] is None
    assert (shown["alarms"], shown["verdict"]) == ([], CANNOT)
    assert shown["told"][0].startswith("Cannot tell yet: 3 sessions")


@pytest.mark.slow
def test_a_simulated_trial_is_dated_by_its_own_day_and_the_order_of_entry_has_no_influence(
        bench: Path, bowden: Callable[..., Any], here: Path) -> None:
    told(bowden, "logbook", "init", "book", "--name", "left leg", "--references", "2")
    for day in reversed(range(DAYS)):
        told(bowden, "logbook", "add", "book", bench / f"{day}.mcap")
    one, other = (told(bowden, "logbook", "show", folder) for folder in ("book", bench / "book"))
    assert one == other


def test_the_path_of_the_logbook_is_not_in_the_trial(bench: Path) -> None:
    from trial.read import open as opened

    recorded = opened(bench / "1.mcap")
    assert "logbook" not in recorded.metadata
    assert b'logbook = ""' in recorded.attachments["bench.toml"]


def test_a_session_against_the_bench_s_history(bench: Path, bowden: Callable[..., Any]) -> None:
    found = told(bowden, "compare", bench / "2.mcap", "--logbook", bench / "book")
    assert found["sessions"] == DAYS - 1  # its own session is left out
    assert found["probability"] > 1e-3


def test_export_as_csv_and_parquet(bench: Path, bowden: Callable[..., Any], here: Path) -> None:
    constants = told(bowden, "logbook", "export", bench / "book", "--table", "constants", "-o", here / "c.csv")
    assert constants["rows"] % DAYS == 0
    assert (here / "c.csv").read_text(encoding="utf-8").startswith("session,label,constant,unit,value,low,high\n")
    assert told(bowden, "logbook", "export", bench / "book", "-o", here / "t.parquet")["rows"] == DAYS


def test_the_page_shows_constants_and_leads_to_trials(bench: Path, browser: Any, bowden: Callable[..., Any],
                                                      here: Path) -> None:
    shutil.copytree(bench / "book", here / "book")
    told(bowden, "logbook", "note", here / "book", "rope" * 400)
    told(bowden, "logbook", "report", here / "book", "-o", here / "page.html")
    browser.open(here / "page.html")
    assert browser.complaints == []
    assert browser.run("document.documentElement.scrollWidth <= innerWidth"), "a long word widens no page"
    scatter = browser.run("document.querySelector('#constant-stiffness td:last-child').innerText")
    assert re.match(r"[\d.]+ N\npublished", scatter), scatter
    assert browser.run("document.querySelector('p.unknown') !== null")
    assert browser.run("document.querySelectorAll('svg circle').length") == DAYS * browser.run(
        "document.querySelectorAll('svg').length")
    assert browser.run("document.querySelectorAll('tr[id^=session-] a').length") == DAYS
    assert browser.run("getComputedStyle(document.querySelector('.point')).fill") == "rgb(31, 111, 178)"
    numbers = browser.run("[...document.querySelectorAll('td.number')].map(cell => cell.innerText)")
    assert len(numbers) > 50
    assert [text for text in numbers if re.search(r"\de-\d", text) or text.count("\n") > 1] == []


@pytest.mark.exhaustive
def test_a_diagnosis_by_the_logbook_is_kept(bench: Path, bowden: Callable[..., Any]) -> None:
    found = told(bowden, "diagnose", bench / "2.mcap", "--logbook", bench / "book")
    kept = told(bowden, "logbook", "show", bench / "book", "--trial", DAYS)["verdicts"]
    assert [row["verdict"] for row in kept] == [found["verdict"]]


def test_maintenance_resets_the_parts_that_it_names(here: Path, bowden: Callable[..., Any]) -> None:
    told(bowden, "logbook", "init", "book")
    assert told(bowden, "logbook", "note", "book", "replaced START load cell")["resets"] == []
    assert "cable" in told(bowden, "logbook", "note", "book", "new cable", "--part", "cable")["resets"]
    assert told(bowden, "logbook", "note", "book", "swapped", "--part", "START")["resets"] == [
        "start_gain", "start_offset", "start_lag"]


LAB = "time_s,tension_start_n\n" + "".join(f"{k / 100},{k % 7}\n" for k in range(200))


def test_a_moved_file_is_told_and_found_again(here: Path, bowden: Callable[..., Any]) -> None:
    told(bowden, "logbook", "init", "book")
    Path("a.csv").write_text(LAB, encoding="utf-8")
    told(bowden, "logbook", "add", "book", "a.csv", "--session", "monday")
    Path("a.csv").rename("b.csv")
    assert [row["there"] for row in told(bowden, "logbook", "list", "book")["newest"]] == [False]
    assert re.search(r"\(not[\s│]*found\)", bowden("logbook", "list", "book").stdout)  # long paths are wrapped
    told(bowden, "logbook", "report", "book", "-o", "page.html")
    assert "file not found" in Path("page.html").read_text(encoding="utf-8")
    status, out, _ = bowden("logbook", "add", "book", "b.csv", "--session", "tuesday")
    assert (status, out.startswith("Trial 1, session monday: "), "it was entered before" in out) == (0, True, True), out
    assert "keeps that session; --session tuesday is not used" in out
    again = told(bowden, "logbook", "list", "book")["newest"]
    assert [(row["there"], row["label"]) for row in again] == [(True, "monday")]


def test_lab_data_without_what_a_fit_needs_are_kept_with_the_reason(here: Path, bowden: Callable[..., Any]) -> None:
    told(bowden, "logbook", "init", "book")
    Path("lab.csv").write_text(LAB, encoding="utf-8")
    added = told(bowden, "logbook", "add", "book", "lab.csv", "--session", "monday")["added"][0]
    assert not added["estimated"]
    assert added["remark"].startswith("has no column servo_position_m"), "the path stands beside it"
    assert added["remark"].endswith("or compare a rig of another kind by bowden diagnose --healthy.")
    status, out, _ = bowden("logbook", "show", "book", "--trial", 1)
    assert (status, out.count("lab.csv"), "s recorded; not fitted: has no column" in out) == (0, 1, True), out
    assert re.search(r"[{}]|\d\.\d{4}", out) is None, out
    said = " ".join(bowden("logbook", "show", "book").stdout.split())
    assert "1 more session has no trial that could be fitted; bowden logbook show --trial NUMBER says why." in said


def test_the_list_has_the_reason_of_each_trial_without_a_fit_once(here: Path, bowden: Callable[..., Any]) -> None:
    told(bowden, "logbook", "init", "book")
    Path("lab.csv").write_text(LAB, encoding="utf-8")
    Path("more.csv").write_text(LAB + "\n", encoding="utf-8")
    rope(Path("locked.csv"), 0.1, "servo_position_m", "tension_start_n")
    added = [told(bowden, "logbook", "add", "book", name, "--session", "monday")["added"][0]
             for name in ("lab.csv", "more.csv", "locked.csv")]
    assert [entry["estimated"] for entry in added] == [False, False, True]
    status, out, err = bowden("logbook", "list", "book")
    assert (status, err) == (0, "")
    assert f"No fit of trials 2, 1: {added[0]['remark']}" in " ".join(out.split())
    assert out.count("No fit of") == 1
    assert max(map(len, out.splitlines())) <= 80


def rope(path: Path, phase: float, *columns: str) -> None:
    """Write a table of a rope pulled against a spring with friction, knee locked, with `columns` beside time."""
    time = np.arange(0, 4, 0.02)
    position = 0.01 + 0.01 * np.sin(np.pi * time + phase)
    start = 20 + 2500 * position + 4 * np.sign(np.cos(np.pi * time + phase))
    noise = np.random.default_rng(round(1000 * phase)).normal(0, 0.05, (2, len(time)))
    every = {"servo_position_m": position, "tension_start_n": start + noise[0], "tension_end_n": 0.6 * start + noise[1]}
    np.savetxt(path, np.column_stack([time, *(every[name] for name in columns)]), delimiter=",", comments="",
               header=",".join(("time_s", *columns)))


def test_a_rope_with_a_locked_knee_is_followed_without_the_angle(here: Path, bowden: Callable[..., Any]) -> None:
    told(bowden, "logbook", "init", "book")
    for k in range(2):
        rope(Path(f"{k}.csv"), 0.3 * k, "servo_position_m", "tension_start_n")
        added = told(bowden, "logbook", "add", "book", f"{k}.csv", "--session", f"day {k}")["added"][0]
        assert added["estimated"], added


def test_a_rig_without_a_knee_is_kept_with_the_reason_why_it_is_not_followed(
    here: Path, bowden: Callable[..., Any]
) -> None:
    told(bowden, "logbook", "init", "book")
    rope(Path("rig.csv"), 0.1, "servo_position_m", "tension_start_n", "tension_end_n")
    status, out, err = bowden("logbook", "add", "book", "rig.csv", "--session", "monday")
    assert (status, err) == (0, "")
    assert "not fitted: has no column knee_angle_rad, and START and END without a knee are of a cable or a seal" in out
    assert "bowden diagnose --healthy" in out


ENTER = """
import sys
from pathlib import Path
from logbook import database
with database.open_logbook(Path(sys.argv[1])) as book:
    for k in range(int(sys.argv[3])):
        digest = f"{sys.argv[2]}{k}"
        new = database.NewTrial(Path(digest), digest, "gait", "completed", 10.0, {}, {}, "")
        print(book.enter_trial(new, f"{sys.argv[2]} {k // 5}")[0], flush=True)
"""


def entering(name: str, count: int) -> subprocess.Popen[str]:
    """Start a process that enters `count` trials and prints the number of each once it is acknowledged."""
    return subprocess.Popen([sys.executable, "-c", ENTER, "book", name, str(count)], stdout=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_two_processes_enter_at_once(here: Path, bowden: Callable[..., Any]) -> None:
    told(bowden, "logbook", "init", "book")
    numbers = [process.communicate()[0].split() for process in [entering("a", 40), entering("b", 40)]]
    assert len({*numbers[0], *numbers[1]}) == 80
    assert told(bowden, "logbook", "list", "book")["trials"] == 80


@pytest.mark.slow
def test_a_killed_process_loses_nothing_acknowledged(here: Path, bowden: Callable[..., Any]) -> None:
    told(bowden, "logbook", "init", "book")
    for turn in range(3):
        with entering(f"k{turn}", 100000) as process:
            assert process.stdout is not None
            acknowledged = [int(process.stdout.readline()) for _ in range(7 + turn)]
            process.kill()
            acknowledged += [int(line) for line in process.stdout if line.endswith("\n")]
        with database.open_logbook(Path("book")) as book:
            assert all(book.trials(1, trial=number) for number in acknowledged)
    assert sqlite3.connect("book/logbook.sqlite").execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_an_older_schema_is_brought_up_and_a_newer_one_refused(here: Path, bowden: Callable[..., Any]) -> None:
    Path("book").mkdir()
    db = sqlite3.connect("book/logbook.sqlite")
    db.executescript(database.MIGRATIONS[0])
    db.execute("INSERT INTO setting VALUES ('name', 'old'), ('references', '5')")
    db.execute(f"PRAGMA application_id = {database.APPLICATION}")
    db.execute("PRAGMA user_version = 1")
    db.commit()
    assert told(bowden, "logbook", "list", "book")["bench"] == "old"
    assert db.execute("PRAGMA user_version").fetchone() == (len(database.MIGRATIONS),)
    db.execute("PRAGMA user_version = 99")
    db.close()
    status, out, err = bowden("logbook", "list", "book")
    assert (status, out) == (2, "")
    assert "is of schema 99" in err


class Accuracy(NamedTuple):
    """What one trial determines: its sums and the encoded reference posterior."""

    sums: SessionSums
    model: bytes


@pytest.fixture(scope="module")
def accuracy(bench: Path) -> Accuracy:
    """The sums of the bench's last day."""
    with open_logbook(bench / "book") as book:
        kept = book.reference()
        assert kept is not None
        return Accuracy(book.sums(kept.id, [DAYS])[DAYS], kept.model)


def test_the_error_of_the_linearisation_counts_as_noise_of_a_session(bench: Path, accuracy: Accuracy) -> None:
    # sessions that depart by 1σ, without noise: what the linear model misses of them is no evidence of an effect
    fit, table = decoded(accuracy.model, PATH_MODEL), PATH_MODEL.constants
    trial, q = recording_of(bench / "0.mcap", "completed", ""), fit.prior.coordinates(table)
    made, weight = slopes(fit.model, effect_columns(fit), q, trial), fit.observe(trial).weight
    departures = np.random.default_rng(1).normal(size=(16, len(FREE))) * PUBLISHED
    sets = np.repeat(q[:, None], len(departures), axis=1)
    sets[list(FREE)] += departures.T
    missed = fit.model.predict(sets, trial) - made.data - departures @ made.base.T

    def scores(further: np.ndarray | None) -> float:
        every = [summed(made.base, made.effects, each, weight, further) for each in missed]
        return float(np.sqrt(np.mean([one.pull**2 / np.diag(one.square).clip(1e-6) for one in every])))

    assert scores(linearisation_error(fit.model, q, made, PUBLISHED, trial)) < 1.5 < scores(None)


def drawn(of: Accuracy, seed: int, sessions: int, course: Callable[[int], dict[str, float]]) -> Iterator[SessionSums]:
    """Yield sums of sessions that scatter as published and depart by `course(session)`, coordinates."""
    random, square = np.random.default_rng(seed), of.sums.sums.square
    lengths, axes = np.linalg.eigh(square)
    root = axes * np.sqrt(np.maximum(lengths, 0.0))
    for k in range(sessions):
        x = np.zeros(square.shape[0])
        x[:PUBLISHED.size] = PUBLISHED * random.normal(size=PUBLISHED.size)
        for name, size in course(k).items():
            x[CONSTANTS.index(name)] += size
        yield of.sums._replace(sums=Sums(square, square @ x + root @ random.normal(size=x.size)))


def written(folder: Path, of: Accuracy, sessions: Iterator[SessionSums], notes: dict[int, str] | None = None) -> Path:
    """Write a logbook of these sessions; `notes`: parts that are new after a session."""
    database.create(folder, "drawn")
    with open_logbook(folder) as book:
        assert book.enter_reference(CONSTANTS, [], np.zeros((0, 4)), of.model, None)
        for k, found in enumerate(sessions):
            new = NewTrial(Path(f"{k}.mcap"), str(k), "gait", "completed", 10.0, {}, {}, "")
            number, _ = book.enter_trial(new, f"day {k}", float(k))
            assert book.enter_sums(number, 1, found)
            for part in filter(None, [(notes or {}).get(k)]):
                book.enter_note(f"{part} replaced", constants_of([part]), k + 1)
    return folder


def shown(bowden: Callable[..., Any], folder: Path, *words: object) -> dict[str, Any]:
    """Return the JSON object of `bowden logbook show`."""
    status, out, err = bowden("logbook", "show", folder, *words, "--json")
    assert status == 0, err
    found: dict[str, Any] = json.loads(out)
    return found


def test_healthy_sessions_raise_no_alarm_and_their_scatter_is_measured(accuracy: Accuracy, here: Path,
                                                                      bowden: Callable[..., Any]) -> None:
    found = shown(bowden, written(here / "book", accuracy, drawn(accuracy, 3, 16, lambda k: {})))
    assert (found["alarms"], found["verdict"]) == ([], UNCHANGED)
    stiffness = found["constants"]["stiffness"]
    assert 0.5 < stiffness["session_sd"] / stiffness["published_session_sd"] < 2.0


def test_measured_scatter_replaces_the_published_one(accuracy: Accuracy, here: Path, bowden: Callable[..., Any]
                                                     ) -> None:
    wild = np.random.default_rng(2).normal(size=16)
    sessions = drawn(accuracy, 1, 16, lambda k: {"start_offset": 0.4 * wild[k]})
    found = shown(bowden, written(here / "book", accuracy, sessions))["constants"]["start_offset"]
    assert found["session_sd"] > 2.0 * found["published_session_sd"]


def test_a_session_that_departs_alone_is_no_change(accuracy: Accuracy, here: Path, bowden: Callable[..., Any]) -> None:
    """With the published scatter alone, 40 σ of one session and two like the others would have 68 nats."""
    far = {"cable": 40.0 * float(PUBLISHED[CONSTANTS.index("cable")])}
    sessions = drawn(accuracy, 4, 14, lambda k: far if k == 11 else {})
    assert shown(bowden, written(here / "book", accuracy, sessions))["alarms"] == []


@pytest.mark.parametrize(("motion", "verdict"), [(0, CHANGED), (1, UNCHANGED), (None, UNCHANGED)])
def test_what_the_model_misses_in_another_motion_is_no_change(
        accuracy: Accuracy, here: Path, bowden: Callable[..., Any], motion: int | None, verdict: str) -> None:
    """Sessions from the ninth on depart alike: in the motion of those before they are a change, in another one not."""
    away = {"cable": 6.0 * float(PUBLISHED[CONSTANTS.index("cable")])}
    sessions = drawn(accuracy, 4, 16, lambda k: away if k >= 8 else {})
    moved = (one if k < 8 else one._replace(motion=motion) for k, one in enumerate(sessions))
    assert shown(bowden, written(here / "book", accuracy, moved))["verdict"] == verdict


def test_a_session_keeps_the_motion_of_its_trials(bench: Path, here: Path, bowden: Callable[..., Any]) -> None:
    shutil.copytree(bench / "book", "book")
    told(bowden, "trial", "--cycles", 3, "--period", 1.5, "--serial", 3, "--day", DAYS, "--logbook", "book",
         "-o", "other.mcap")
    with open_logbook(Path("book")) as book:
        kept = book.reference()
        assert kept is not None
        assert kept.motions.shape == (len(kept.trials), 4)
        sums = book.sums(kept.id, range(1, DAYS + 2))
        assert [sums[session].motion for session in sorted(sums)] == [*[0] * DAYS, None]


DRIFTS = {
    "cable friction +30 % over 15 sessions": ("cable_friction", lambda k: {"cable": 0.26 * max(0, k - 10) / 15}),
    "backlash 26 mrad": ("knee_backlash", lambda k: {"play": 0.013 if k >= 20 else 0.0}),
    # -10 %, 3.5 σ of a session, is stated in one of eight draws
    "stiffness -20 %": ("stiffness", lambda k: {
        name: -0.223 * share for name, share in (("stiffness", 1.0), ("curve2", 0.4), ("curve3", 0.2)) if k >= 20}),
    "START gain +3 %": ("start_gain", lambda k: {"start_gain": 0.03 if k >= 20 else 0.0}),
}


MARKS = dict(zip(DRIFTS, ((pytest.mark.exhaustive,), (), (pytest.mark.exhaustive,), (pytest.mark.slow,)), strict=True))


@pytest.mark.parametrize("name", [pytest.param(name, marks=marks) for name, marks in MARKS.items()])
def test_a_drift_is_dated_and_has_the_evidence_of_its_effect(accuracy: Accuracy, here: Path,
                                                             bowden: Callable[..., Any], name: str) -> None:
    effect, course = DRIFTS[name]
    found = shown(bowden, written(here / "book", accuracy, drawn(accuracy, 6, 25, course)))
    assert len(found["alarms"]) == 1
    evidence = {change["effect"]: change["nats"] for change in found["changes"]}
    assert evidence[effect] >= SET_SHARE * max(evidence.values())
    if "backlash" in name:
        assert found["alarms"][0]["since"] == "day 20"


@pytest.mark.slow
def test_an_alarm_without_recorded_trials_is_named_by_all_sessions(accuracy: Accuracy, here: Path,
                                                                   bowden: Callable[..., Any]) -> None:
    book = written(here / "book", accuracy, drawn(accuracy, 5, 25, DRIFTS["backlash 26 mrad"][1]))
    alarm = shown(bowden, book)["alarms"][0]
    assert (alarm["verdict"], alarm["among"], alarm["part"]) == (None, [], "geometry")
    assert "knee_backlash" in alarm["effects"]  # by the evidence of all sessions
    assert alarm["remark"] == "no trial since the change is at hand as it was recorded."
    (book / "24.mcap").write_bytes(b"another content than the one that was entered")
    assert shown(bowden, book)["alarms"][0] == alarm
    text = bowden("logbook", "show", book).stdout
    assert text.startswith("Changed since session day 20, as a step: knee backlash")
    assert "No diagnosis of one session: no trial since the change is at hand" in text


KEPT = Cause("ambiguous", ("start_gain", "end_gain"), "sensor", "", 25, (1, 2), ("24.mcap",), 5)
"""A diagnosis of session 25, "day 24", when it was the fifth since the change."""


@pytest.mark.parametrize(("cause", "notes", "among"), [
    (KEPT, {}, ["start_gain", "end_gain"]), (KEPT._replace(session=20), {}, []),
    (KEPT._replace(references=(1, 21)), {}, []), (KEPT, {9: "cable"}, []),
], ids=["valid", "of a session before the change", "reference since the change", "maintenance in between"])
@pytest.mark.slow
def test_a_kept_diagnosis_holds_while_its_sessions_are_on_both_sides_of_the_change(
        cause: Cause, notes: dict[int, str], among: list[str], accuracy: Accuracy, here: Path,
        bowden: Callable[..., Any]) -> None:
    folder = written(here / "book", accuracy, drawn(accuracy, 5, 25, DRIFTS["START gain +3 %"][1]), notes)
    with open_logbook(folder) as book:
        enter_cause(book, cause)
    alarm = shown(bowden, folder)["alarms"][0]
    assert alarm["among"] == among
    assert ("Diagnosis of session day 24" in bowden("logbook", "show", folder).stdout) == bool(among)


@pytest.mark.parametrize("cause", [
    KEPT._replace(verdict="unexplained", among=(), part=None), KEPT._replace(among=("end_offset", "start_gain")),
], ids=["one session has no name", "one session prefers another effect"])
@pytest.mark.slow
def test_an_effect_with_evidence_in_all_sessions_comes_first(cause: Cause, accuracy: Accuracy, here: Path,
                                                             bowden: Callable[..., Any]) -> None:
    folder = written(here / "book", accuracy, drawn(accuracy, 5, 25, DRIFTS["START gain +3 %"][1]))
    with open_logbook(folder) as book:
        enter_cause(book, cause)
    alarm = shown(bowden, folder)["alarms"][0]
    assert (alarm["effects"][0], alarm["part"]) == ("start_gain", "elasticity and gains")
    assert ", as a step: START gain" in bowden("logbook", "show", folder).stdout.splitlines()[0]


@pytest.mark.parametrize(("sessions", "verdict"), [(23, UNCHANGED), (25, CHANGED)])
@pytest.mark.slow
def test_a_suspicion_that_its_diagnosis_contradicts_is_stated_from_five_sessions_on(
        sessions: int, verdict: str, accuracy: Accuracy, here: Path, bowden: Callable[..., Any]) -> None:
    folder = written(here / "book", accuracy, drawn(accuracy, 5, sessions, DRIFTS["START gain +3 %"][1]))
    with open_logbook(folder) as book:
        enter_cause(book, KEPT._replace(verdict="none", among=(), part=None, session=sessions, since=sessions - 20))
    found = shown(bowden, folder)
    assert (found["verdict"], len(found["alarms"])) == (verdict, int(verdict == CHANGED))
    text = bowden("logbook", "show", folder).stdout
    assert (f"but the diagnosis of session day {sessions - 1} finds none" in text) == (verdict == UNCHANGED)


@pytest.mark.slow
def test_a_drift_is_forecast_to_a_limit(accuracy: Accuracy, here: Path, bowden: Callable[..., Any]) -> None:
    book = written(here / "book", accuracy, drawn(accuracy, 4, 30, lambda k: {"cable": 0.02 * max(0, k - 10)}))
    now = shown(bowden, book)["constants"]["cable"]["value"]
    ahead = shown(bowden, book, "--limit", f"cable={now * np.exp(0.2)}")["forecasts"][0]
    assert ahead["low"] < 10.0 < ahead["high"]  # 0.02 a session, 0.2 to go


@pytest.mark.slow
def test_a_replaced_cable_is_no_alarm_if_it_is_entered(accuracy: Accuracy, here: Path, bowden: Callable[..., Any]
                                                       ) -> None:
    def course(k: int) -> dict[str, float]:
        return {"cable": -0.4, "viscous": 3.0} if k >= 20 else {}

    told = shown(bowden, written(here / "a", accuracy, drawn(accuracy, 6, 30, course), {19: "cable"}))
    assert told["alarms"] == []
    assert told["notes"][0]["after"] == "day 19"
    untold = shown(bowden, written(here / "b", accuracy, drawn(accuracy, 6, 30, course)))
    assert untold["alarms"][0]["since"] == "day 20"


def test_the_page_tells_the_alarm_first(accuracy: Accuracy, here: Path, browser: Any, bowden: Callable[..., Any]
                                        ) -> None:
    book = written(here / "book", accuracy, drawn(accuracy, 5, 30, lambda k: {"play": 0.013 if k >= 20 else 0.0}),
                   {15: "fabric"})
    assert bowden("logbook", "report", book, "-o", "page.html").status == 0
    browser.open(here / "page.html")
    assert browser.complaints == []
    assert browser.run("document.querySelector('h1 ~ p.alarm b').textContent").startswith("Changed since session day 2")
    assert browser.run("document.querySelector('tr.moved').id") == "constant-play"
    assert browser.run("document.querySelectorAll('tr.moved line.change').length") >= 1
    assert browser.run("document.querySelectorAll('line.note').length") > 0
    browser.run("document.querySelector('p.alarm a').click()")
    assert browser.run("location.hash") == "#session-21"


@pytest.mark.parametrize(("words", "said"), [
    (("logbook", "list", "none"), "holds no logbook"), (("logbook", "init", "book"), "there is a logbook already"),
    (("logbook", "add", "book", "none.mcap"), "cannot be read"), (("logbook", "note", "book", " "), "text is empty"),
    (("logbook", "note", "book", "x", "--part", "moon"), "--part moon"),
    (("logbook", "note", "book", "x", "--after", "moon"), "--after moon"),
    (("logbook", "show", "book", "--limit", "cable"), "expected NAME=VALUE"),
    (("logbook", "show", "book", "--limit", "moon=1"), "is no constant of the bench"),
    (("logbook", "show", "book", "--trial", "7"), "is not in the logbook"),
    (("logbook", "export", "book", "--table", "moon", "-o", "x.csv"), "--table moon"),
    (("logbook", "init", "other", "--references", "1"), "--references 1"),
    (("logbook", "add", "book", "lab.csv", "--session", "2026-13-45"), "is no date of the calendar"),
    (("logbook", "add", "book", "lab.csv", "--session", "9999-01-01"), "is in the future"),
    (("trial", "--logbook", "book", "--label", "2026-13-45", "-o", "x.mcap"), "is no date of the calendar"),
    (("trial", "--logbook", "none", "-o", "x.mcap"), "holds no logbook"),
    (("fit", "x.mcap", "--logbook", "none", "-o", "x.toml"), "holds no logbook"),
    (("identify", "swing", "--logbook", "none", "-o", "x.toml"), "holds no logbook"),
    (("diagnose", "x.mcap", "--logbook", "none"), "holds no logbook"), (("compare", "x.mcap"), "give one"),
], ids=lambda given: " ".join(given) if isinstance(given, tuple) else "")
def test_bad_input_is_one_sentence(here: Path, bowden: Callable[..., Any], words: tuple[str, ...], said: str) -> None:
    assert bowden("logbook", "init", "book").status == 0
    Path("lab.csv").write_text(LAB, encoding="utf-8")
    before = sorted(here.iterdir())
    status, out, err = bowden(*words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert sorted(here.iterdir()) == before
