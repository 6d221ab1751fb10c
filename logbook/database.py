"""The logbook's file: trials, sessions, estimates, verdicts and maintenance in one SQLite database.

Every entry is one transaction in write-ahead mode with full synchronisation: an entry that was acknowledged survives
kill −9.  A second process waits for the first, at most `PATIENCE_S`.
"""

from __future__ import annotations

import datetime
import json
import os
import re
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from estimation.linear_sums import SessionSums, Sums
from parameters import InputError
from parameters.files import json_text
from physics.laws import Array
from physics.older_files import renamed_in_sql

FILE: Final = "logbook.sqlite"
PATIENCE_S: Final = 60.0
"""Longest wait for another process's entry, s; an entry itself takes milliseconds."""
APPLICATION: Final = 0x424F5744
"""SQLite's application_id of a logbook: "BOWD"."""
REFERENCES: Final = 3
"""Number of reference sessions, counted from the first, without `bowden logbook init --references`."""
UNFITTED: Final = "not fitted yet"
"""Remark of a trial whose fit was not made yet."""
MIGRATIONS: Final = ("""
CREATE TABLE setting (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE session (id INTEGER PRIMARY KEY, label TEXT NOT NULL UNIQUE, began TEXT NOT NULL);
CREATE TABLE trial (
    id INTEGER PRIMARY KEY, session INTEGER NOT NULL REFERENCES session(id), digest TEXT NOT NULL UNIQUE,
    path TEXT NOT NULL, added TEXT NOT NULL, experiment TEXT NOT NULL, outcome TEXT, seconds REAL NOT NULL,
    conditions TEXT NOT NULL, figures TEXT NOT NULL, software TEXT NOT NULL);
CREATE TABLE reference (
    id INTEGER PRIMARY KEY, made TEXT NOT NULL, constants TEXT NOT NULL, trials TEXT NOT NULL, bench BLOB NOT NULL,
    model BLOB NOT NULL);
CREATE TABLE estimate (
    trial INTEGER PRIMARY KEY REFERENCES trial(id), reference INTEGER REFERENCES reference(id), remark TEXT NOT NULL,
    mean BLOB, covariance BLOB, prior_sd BLOB, rmse_n REAL);
CREATE TABLE verdict (
    id INTEGER PRIMARY KEY, trial INTEGER NOT NULL REFERENCES trial(id), made TEXT NOT NULL, content TEXT NOT NULL);
CREATE TABLE model (
    id INTEGER PRIMARY KEY, made TEXT NOT NULL, kind TEXT NOT NULL, path TEXT NOT NULL, content TEXT NOT NULL);
CREATE TABLE note (
    id INTEGER PRIMARY KEY, made TEXT NOT NULL, after INTEGER NOT NULL, text TEXT NOT NULL, resets TEXT NOT NULL);
""", """
CREATE INDEX trial_of_session ON trial(session);
CREATE INDEX verdict_of_trial ON verdict(trial);
""", """
CREATE TABLE cause (id INTEGER PRIMARY KEY, made TEXT NOT NULL, content TEXT NOT NULL);
""", """
ALTER TABLE session ADD COLUMN place REAL;
DELETE FROM cause;
DROP TABLE estimate;
DELETE FROM reference;
CREATE TABLE estimate (
    trial INTEGER PRIMARY KEY REFERENCES trial(id), reference INTEGER REFERENCES reference(id), remark TEXT NOT NULL,
    square BLOB, pull BLOB, growth BLOB, rmse_n REAL);
""", ";".join(renamed_in_sql(*place) for place in (("reference", "constants"), ("note", "resets"))),
    "DELETE FROM estimate", "DELETE FROM cause; DELETE FROM estimate; DELETE FROM reference", "DELETE FROM estimate",
    """
DELETE FROM reference;
ALTER TABLE reference RENAME COLUMN bench TO motions;
DROP TABLE estimate;
CREATE TABLE estimate (
    trial INTEGER PRIMARY KEY REFERENCES trial(id), reference INTEGER REFERENCES reference(id), remark TEXT NOT NULL,
    square BLOB, pull BLOB, growth BLOB, motion INTEGER);
""", "DELETE FROM cause; DELETE FROM estimate", "DELETE FROM cause; DELETE FROM estimate",
    "DELETE FROM cause; DELETE FROM estimate; DELETE FROM reference",
    "DELETE FROM cause; DELETE FROM estimate; DELETE FROM reference",
    "DELETE FROM cause; DELETE FROM estimate; DELETE FROM reference",
    "DELETE FROM cause; DELETE FROM estimate; DELETE FROM reference")
"""SQL of each version of the schema, applied to the one before it; `PRAGMA user_version` counts them.

The fourth and those from the sixth on drop estimates of single trials, which a later `add` makes anew from the files.
Sixth: effects have secants, too.  Seventh, with the references: friction is distributed (decision 50).  Eighth: effects
free more constants (decision 52).  Ninth, with the references: a trial is linearised by its motion (decision 57).
Tenth: a stiffness may move the zero that homing fixes (decision 60).  Eleventh: the error of the linearisation counts
as noise (decision 61).  From the twelfth on with the references: pre-sliding has a shape (decision 62), a drive's
constants scatter by a share of their own (decision 63), derivatives have a smaller step (decision 64).  Fifteenth: a
fit starts at a lever arm beside its prior, and what else changed is known to a tenth (decision 68).  The fifth
renames constants."""


class TrialEntry(NamedTuple):
    """One trial as the logbook keeps it; `path` as recorded, `there` whether the file is at it now."""

    id: int
    session: int
    label: str
    path: str
    there: bool
    added: str
    experiment: str
    outcome: str | None
    seconds: float
    conditions: dict[str, str]
    figures: dict[str, Any]
    software: str
    estimated: bool
    remark: str


def unfitted(entries: Sequence[TrialEntry]) -> Iterator[str]:
    """Yield, for each reason why trials of `entries` have no fit, a line with their numbers and the reason."""
    for reason in dict.fromkeys(entry.remark for entry in entries if not entry.estimated):
        numbers = [str(entry.id) for entry in entries if not entry.estimated and entry.remark == reason]
        yield f"No fit of trial{'s' * (len(numbers) > 1)} {', '.join(numbers)}: {reason}"


class NewTrial(NamedTuple):
    """A trial to enter; `digest`: SHA-256 of its file."""

    path: Path
    digest: str
    experiment: str
    outcome: str | None
    seconds: float
    conditions: Mapping[str, str]
    figures: Mapping[str, Any]
    software: str


class SessionEntry(NamedTuple):
    """One session: its number, label, first entry, trials, recorded seconds, and its `place` in time.

    `place`: days of a date or number of a simulated day; None: the label is neither, and no recording has a date.
    """

    id: int
    label: str
    began: str
    trials: int
    seconds: float
    place: float | None


class Note(NamedTuple):
    """A maintenance entry: made after session `after`; `resets`: constants that it changed."""

    id: int
    made: str
    after: int
    text: str
    resets: tuple[str, ...]


class ReferenceModel(NamedTuple):
    """A reference model: names of its constants, the trials it was fitted to, their motion, its encoded content.

    `motions`: `estimation.linear_sums.motion_spread` of each of the trials, shape (trials, 4).
    """

    id: int
    constants: tuple[str, ...]
    trials: tuple[int, ...]
    motions: Array
    model: bytes


class Logbook:
    """One open logbook; use it as a context manager."""

    def __init__(self, folder: Path, connection: sqlite3.Connection) -> None:
        self.folder = folder
        self._connection = connection

    def __enter__(self) -> Logbook:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the database."""
        self._connection.close()

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """Hold the write lock for one transaction: all of it is kept, or nothing."""
        with _reporting(self.folder / FILE):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
            except BaseException:
                self._connection.execute("ROLLBACK")
                raise
            self._connection.execute("COMMIT")

    def _rows(self, query: str, given: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        with _reporting(self.folder / FILE):
            return self._connection.execute(query, given).fetchall()

    # -- settings ------------------------------------------------------------------------------------------------

    @property
    def path(self) -> str:
        """The force path that is followed, of a bench of several; "" of a bench of a single one."""
        rows = self._rows("SELECT value FROM setting WHERE key = 'path'")
        return str(rows[0][0]) if rows else ""

    @property
    def references(self) -> int:
        """Number of reference sessions."""
        return int(self._rows("SELECT value FROM setting WHERE key = 'references'")[0][0])

    @property
    def name(self) -> str:
        """Name of the bench."""
        return str(self._rows("SELECT value FROM setting WHERE key = 'name'")[0][0])

    # -- entries -------------------------------------------------------------------------------------------------

    def enter_trial(self, new: NewTrial, session: str, place: float | None = None) -> tuple[int, bool]:
        """Enter a trial in the session of that label, which is at `place` in time; return its number and whether it is
        new.

        A file of the same content is entered once; where it was moved, its path is brought up to date.
        """
        path = self._stored(new.path)
        with self._writing() as db:
            known = db.execute("SELECT id FROM trial WHERE digest = ?", (new.digest,)).fetchone()
            if known is not None:
                db.execute("UPDATE trial SET path = ? WHERE id = ?", (path, known[0]))
                return int(known[0]), False
            db.execute("INSERT OR IGNORE INTO session(label, began, place) VALUES (?, ?, ?)", (session, now(), place))
            db.execute("UPDATE session SET place = min(coalesce(place, ?1), ?1) WHERE label = ?2 AND ?1 IS NOT NULL",
                       (place, session))
            of = db.execute("SELECT id FROM session WHERE label = ?", (session,)).fetchone()[0]
            entered = db.execute(
                "INSERT INTO trial(session, digest, path, added, experiment, outcome, seconds, conditions, figures, "
                "software) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (of, new.digest, path, now(), new.experiment, new.outcome, new.seconds, json_text(new.conditions, str),
                 json_text(new.figures, str), new.software))
            return int(entered.lastrowid or 0), True

    def enter_reference(self, constants: Sequence[str], trials: Sequence[int], motions: Array, model: bytes,
                        after: int | None) -> bool:
        """Enter a reference model unless another one than `after` is the newest; return whether it was entered."""
        with self._writing() as db:
            newest = db.execute("SELECT max(id) FROM reference").fetchone()[0]
            if newest != after:
                return False
            db.execute("INSERT INTO reference(made, constants, trials, motions, model) VALUES (?, ?, ?, ?, ?)", (
                now(), json.dumps(list(constants)), json.dumps(list(trials)), _packed(motions), model))
            return True

    def enter_sums(self, trial: int, reference: int, found: SessionSums) -> bool:
        """Enter the sums of a trial; False, and nothing entered, if a newer reference model is there."""
        with self._writing() as db:
            if db.execute("SELECT max(id) FROM reference").fetchone()[0] != reference:
                return False
            upper = found.sums.square[np.triu_indices(found.sums.pull.size)]
            db.execute("INSERT OR REPLACE INTO estimate VALUES (?, ?, '', ?, ?, ?, ?)", (
                trial, reference, *map(_packed, (upper, found.sums.pull, found.growth)), found.motion))
            return True

    def enter_remark(self, trial: int, remark: str) -> None:
        """Enter the reason why a trial has no estimate."""
        with self._writing() as db:
            db.execute("INSERT OR REPLACE INTO estimate(trial, remark) VALUES (?, ?)", (trial, remark))

    def enter_verdict(self, trial: int, content: Mapping[str, Any]) -> None:
        """Enter the verdict of a diagnosis of a trial."""
        with self._writing() as db:
            db.execute("INSERT INTO verdict(trial, made, content) VALUES (?, ?, ?)",
                       (trial, now(), json_text(content, str)))

    def enter_cause(self, content: Mapping[str, Any]) -> None:
        """Enter the diagnosis of a change."""
        with self._writing() as db:
            db.execute("INSERT INTO cause(made, content) VALUES (?, ?)", (now(), json_text(content, str)))

    def enter_model(self, kind: str, path: Path, content: str) -> None:
        """Enter a bench model file: `kind` "calibration" of identify, "fit" of fit."""
        with self._writing() as db:
            db.execute("INSERT INTO model(made, kind, path, content) VALUES (?, ?, ?, ?)",
                       (now(), kind, self._stored(path), content))

    def enter_note(self, text: str, resets: Sequence[str], after: int) -> Note:
        """Enter maintenance done after the session `after` (0: before the first one)."""
        with self._writing() as db:
            made = now()
            entered = db.execute("INSERT INTO note(made, after, text, resets) VALUES (?, ?, ?, ?)",
                                 (made, after, text, json.dumps(list(resets))))
            return Note(int(entered.lastrowid or 0), made, after, text, tuple(resets))

    # -- reading -------------------------------------------------------------------------------------------------

    def counts(self) -> dict[str, int]:
        """Return how many trials, sessions and notes there are."""
        return {what: int(self._rows(f"SELECT count(*) FROM {what}")[0][0]) for what in ("trial", "session", "note")}

    def hours(self) -> float:
        """Return the recorded time of all trials, h."""
        return float(self._rows("SELECT coalesce(sum(seconds), 0) FROM trial")[0][0]) / 3600.0

    def trials(self, most: int | None = None, *, session: int | None = None, trial: int | None = None
               ) -> list[TrialEntry]:
        """Return the newest `most` trials (None: all), newest first; of one session or one number where given."""
        where, given = "", []
        for column, value in (("t.session", session), ("t.id", trial)):
            if value is not None:
                where, given = f"WHERE {column} = ?", [value]
        rows = self._rows(
            "SELECT t.id, t.session, s.label, t.path, t.added, t.experiment, t.outcome, t.seconds, t.conditions, "
            f"t.figures, t.software, e.square IS NOT NULL, coalesce(e.remark, '{UNFITTED}') FROM trial t "
            f"JOIN session s ON s.id = t.session LEFT JOIN estimate e ON e.trial = t.id {where} "
            "ORDER BY t.id DESC LIMIT ?", (*given, -1 if most is None else most))
        return [TrialEntry(r[0], r[1], r[2], r[3], self.place(r[3]).exists(), r[4], r[5], r[6], r[7], json.loads(r[8]),
                           json.loads(r[9]), r[10], bool(r[11]), r[12]) for r in rows]

    def session_of(self, digest: str) -> int | None:
        """Return the session of the trial whose file has that SHA-256."""
        rows = self._rows("SELECT session FROM trial WHERE digest = ?", (digest,))
        return rows[0][0] if rows else None

    def digest(self, trial: int) -> str:
        """Return the SHA-256 of a trial's file as it was entered."""
        return str(self._rows("SELECT digest FROM trial WHERE id = ?", (trial,))[0][0])

    def place(self, stored: str) -> Path:
        """Return where a stored path is: relative ones are relative to the logbook."""
        return self.folder / stored

    def sessions(self) -> list[SessionEntry]:
        """Return the sessions in the order of their dates, whatever the order of entry."""
        rows = self._rows("SELECT s.id, s.label, s.began, count(t.id), coalesce(sum(t.seconds), 0), s.place FROM "
                          "session s LEFT JOIN trial t ON t.session = s.id GROUP BY s.id")
        entries = [SessionEntry(*row) for row in rows]
        return sorted(entries, key=lambda s: (s.place is None, s.place or 0.0, _natural(s.label)))

    def notes(self) -> list[Note]:
        """Return every maintenance entry, oldest first."""
        rows = self._rows("SELECT id, made, after, text, resets FROM note ORDER BY id")
        return [Note(row[0], row[1], row[2], row[3], tuple(json.loads(row[4]))) for row in rows]

    def verdicts(self, trial: int) -> list[dict[str, Any]]:
        """Return the verdicts on one trial, oldest first."""
        rows = self._rows("SELECT made, content FROM verdict WHERE trial = ? ORDER BY id", (trial,))
        return [{"made": made, **json.loads(content)} for made, content in rows]

    def cause(self) -> dict[str, Any] | None:
        """Return the newest diagnosis of a change."""
        rows = self._rows("SELECT content FROM cause ORDER BY id DESC LIMIT 1")
        found: dict[str, Any] | None = json.loads(rows[0][0]) if rows else None
        return found

    def models(self) -> list[dict[str, str]]:
        """Return the bench model files that were entered, oldest first, without their content."""
        return [dict(zip(("made", "kind", "path"), row, strict=True))
                for row in self._rows("SELECT made, kind, path FROM model ORDER BY id")]

    def reference(self) -> ReferenceModel | None:
        """Return the newest reference model."""
        rows = self._rows("SELECT id, constants, trials, motions, model FROM reference ORDER BY id DESC LIMIT 1")
        if not rows:
            return None
        number, constants, trials, motions, model = rows[0]
        return ReferenceModel(number, tuple(json.loads(constants)), tuple(json.loads(trials)),
                              np.frombuffer(motions, "<f8").reshape(-1, 4), model)

    def sums(self, reference: int, sessions: Sequence[int]) -> dict[int, SessionSums]:
        """Return the sums of each of `sessions` that has a trial fitted under one reference model, by session."""
        found: dict[int, SessionSums] = {}
        for session in sessions:
            rows = self._rows(
                "SELECT e.square, e.pull, e.growth, e.motion FROM estimate e JOIN trial t ON t.id = e.trial WHERE "
                "e.reference = ? AND t.session = ? ORDER BY t.digest", (reference, session))
            for one in (_sums(*row) for row in rows):
                found[session] = found[session].joined(one) if session in found else one
        return found

    def unfitted(self) -> list[int]:
        """Return the numbers of trials that were entered but not fitted, under the newest reference model."""
        rows = self._rows(
            "SELECT t.id FROM trial t LEFT JOIN estimate e ON e.trial = t.id WHERE e.trial IS NULL OR (e.square IS NOT "
            "NULL AND e.reference < (SELECT max(id) FROM reference)) ORDER BY t.id")
        return [row[0] for row in rows]

    def table(self, name: str) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Return header and rows of one table without its binary columns."""
        names = [row[1] for row in self._rows(f"PRAGMA table_info({name})") if row[2] != "BLOB"]
        return names, self._rows(f"SELECT {', '.join(names)} FROM {name} ORDER BY 1")

    def _stored(self, path: Path) -> str:
        full = Path(os.path.abspath(path))
        home = Path(os.path.abspath(self.folder))
        return str(full.relative_to(home)) if full.is_relative_to(home) else str(full)


def create(folder: Path, name: str, references: int = REFERENCES, path: str = "") -> None:
    """Make an empty logbook in `folder`, which is made where it is absent; raises `InputError` where one is there.

    `path`: the force path that is followed, of a bench of several.
    """
    place = folder / FILE
    if place.exists():
        raise InputError(f"{folder}: there is a logbook already; give another folder.")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is no folder; give the name of one.")
    if references < 2:
        raise InputError(f"--references {references}: expected at least 2 sessions; one has no variance.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); give a writable place.") from None
    with _reporting(place):
        db = _connected(place)
        try:
            db.execute("PRAGMA journal_mode = WAL")
            _migrate(db, place, {"name": name or folder.name, "references": str(references), "path": path})
        except sqlite3.Error:
            place.unlink()
            raise
        finally:
            db.close()


def open_logbook(folder: Path) -> Logbook:
    """Open the logbook of a folder, brought to this version's schema; raises `InputError` if the folder has none."""
    place = folder / FILE
    if not place.is_file():
        raise InputError(f"{folder}: holds no logbook; say bowden logbook init {folder} first.")
    with _reporting(place):
        db = _connected(place)
        try:
            _migrate(db, place, {})
        except BaseException:
            db.close()
            raise
    return Logbook(folder, db)


def refuse_no_logbook(folder: Path | None) -> None:
    """Raise `InputError` for a folder that holds no logbook, before anything runs."""
    if folder is not None:
        open_logbook(folder).close()


def _connected(place: Path) -> sqlite3.Connection:
    db = sqlite3.connect(place, timeout=PATIENCE_S, isolation_level=None)
    db.execute("PRAGMA synchronous = FULL")
    db.execute("PRAGMA foreign_keys = ON")
    return db


def _migrate(db: sqlite3.Connection, place: Path, settings: Mapping[str, str]) -> None:
    version = db.execute("PRAGMA user_version").fetchone()[0]
    if version > len(MIGRATIONS):
        raise InputError(f"{place}: is of schema {version}, this version knows {len(MIGRATIONS)}; update bowden-bench.")
    if version == len(MIGRATIONS):
        return
    db.execute("BEGIN IMMEDIATE")
    try:
        version = db.execute("PRAGMA user_version").fetchone()[0]  # another process may have been first
        if version and db.execute("PRAGMA application_id").fetchone()[0] != APPLICATION:
            raise InputError(f"{place}: is a database of another program; give a folder made by bowden logbook init.")
        for script in MIGRATIONS[version:]:
            for statement in filter(str.strip, script.split(";")):
                db.execute(statement)
        db.executemany("INSERT INTO setting VALUES (?, ?)", settings.items())
        db.execute(f"PRAGMA application_id = {APPLICATION}")
        db.execute(f"PRAGMA user_version = {len(MIGRATIONS)}")
    except BaseException:
        db.execute("ROLLBACK")
        raise
    db.execute("COMMIT")


@contextmanager
def _reporting(place: Path) -> Iterator[None]:
    """Raise `InputError` where the database cannot be used."""
    try:
        yield
    except sqlite3.OperationalError as error:
        raise InputError(f"{place}: cannot be used ({error}); check the disk, or wait for the other process.") from None
    except sqlite3.DatabaseError as error:
        raise InputError(f"{place}: is no whole logbook ({error}); restore it from a copy.") from None


def now() -> str:
    """Return the present time, UTC, ISO 8601."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _packed(values: Array) -> bytes:
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def _sums(square: bytes, pull: bytes, growth: bytes, motion: int | None) -> SessionSums:
    own = np.frombuffer(pull, "<f8").copy()
    whole = np.zeros((own.size, own.size))
    whole[np.triu_indices(own.size)] = np.frombuffer(square, "<f8")
    whole += np.triu(whole, 1).T
    return SessionSums(Sums(whole, own), np.frombuffer(growth, "<f8").copy(), motion)


def _natural(text: str) -> tuple[tuple[bool, float, str], ...]:
    """Return a key by which numbers in a text are sorted by their value."""
    return tuple((not part.isdigit(), float(part) if part.isdigit() else 0.0, part)
                 for part in re.split(r"(\d+)", text) if part)
