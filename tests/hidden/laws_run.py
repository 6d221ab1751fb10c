"""Laws asked about rigs of another structure: what a law search reaches of what the truth itself would.

    python -m tests.hidden.laws_run [--first SEED] [--left-out N] [--outside N] [--healthy N]
                                    [--structures truth1,truth2] [--rows FILE] [--page]

`--left-out`: effects of the catalogue, which a law search does not use, of `ENLARGED` times their usual size; only
effects that free a constant beyond those of the session are asked, since its constants adapt any other one, and only
those count whose own hypothesis passes the test of a term.
`--outside`: changes that the catalogue never had.  One row of the CSV FILE for each case; a run that was broken off
goes on from there.  `--page` writes the figures of FILE into docs/laws.md.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.frame import DOCS, markdown, put
from diagnosis.compared_signals import Figures
from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.evidence.held_out import HeldOut, blocks_of
from diagnosis.laws.law_findings import discover, unconfirmed
from diagnosis.laws.law_search import LawSearch
from estimation.data.table import Table, table
from estimation.posterior import begun, extra_constants, mode, screened
from physics.effects.carriers import PATH_CARRIERS
from physics.effects.hypotheses import HYPOTHESES, SENSOR
from physics.forward.path_constants import CONSTANTS
from physics.laws import Array
from tests.hidden import truths
from tests.hidden.truths import Question
from tests.hidden.truths_run import stored

START, END = "tension_start_n", "tension_end_n"
Columns = dict[str, Array]
Change = Callable[[Columns, np.random.Generator], Columns]


def _start(columns: Columns, added: Array) -> Columns:
    return {**columns, START: columns[START] + added}


def _end(columns: Columns, added: Array) -> Columns:
    return {**columns, END: columns[END] + added}


def _moving(columns: Columns) -> Array:
    """Return the direction of the rope's motion, −1 … 1."""
    return np.asarray(np.tanh(np.gradient(columns["servo_position_m"], columns["time_s"]) / 5e-3))


def _near(values: Array, random: np.random.Generator) -> Array:
    """Return a bump about a value that the signal passes often."""
    low, high = np.quantile(values, [0.02, 0.98])
    return np.asarray(np.exp(-0.5 * ((values - random.uniform(low, high)) / (0.06 * (high - low))) ** 2))


def _rough(c: Columns, random: np.random.Generator) -> Columns:
    return _start(c, random.uniform(0.1, 0.2) * c[START] * _near(c["servo_position_m"], random) * _moving(c))


def _rub(c: Columns, random: np.random.Generator) -> Columns:
    return _start(c, random.uniform(0.1, 0.2) * c[START] * _near(c["knee_angle_rad"], random) * _moving(c))


def _warms(c: Columns, random: np.random.Generator) -> Columns:
    warmed = 1.0 - np.exp(-(c["time_s"] - c["time_s"][0]) / random.uniform(2.0, 6.0))
    return _start(c, -random.uniform(0.1, 0.2) * c[START] * warmed * _moving(c))


def _relaxes(c: Columns, random: np.random.Generator) -> Columns:
    step, tau = float(np.median(np.diff(c["time_s"]))), random.uniform(0.5, 3.0)
    lagged = np.empty_like(c[END])
    last = c[END][0]
    for i, value in enumerate(c[END]):
        lagged[i] = last = last + step / tau * (value - last)
    return _end(c, -random.uniform(0.1, 0.2) * lagged)


def _loose(c: Columns, random: np.random.Generator) -> Columns:
    return _end(c, random.uniform(0.04, 0.08) * c[END] * (_moving(c) > 0.0))


def _saturates(c: Columns, random: np.random.Generator) -> Columns:
    return {**c, END: np.minimum(c[END], random.uniform(0.6, 0.85) * float(np.quantile(c[END], 0.999)))}


ADDED: Final[Mapping[str, Change]] = {
    "rough_place": _rough, "knee_rub": _rub, "warms": _warms, "relaxes": _relaxes, "loose_one_way": _loose,
    "saturates": _saturates}
"""Changes that are made to the signals of a trial in the reference condition, beside `truths.OUTSIDE` of the rigs."""
FORMS: Final[Mapping[str, tuple[str, ...]]] = {
    "X_slip": ("step",), "X_vib": ("time_sine",), "X_pulse": ("phase_bump",), "X_gainstep": ("step",),
    "rough_place": ("position_bump",), "knee_rub": ("knee_bump",), "warms": ("decay", "time"),
    "relaxes": ("load_memory",), "loose_one_way": ("direction",), "saturates": ("saturation",)}
"""Modulations of the library that have the form of each change."""
ENLARGED: Final = 2.0
"""Factor on the response of an effect that is left out; its own held-out gain is then seldom within model error."""
HEAD: Final = ("kind", "structure", "hidden", "seed", "separation", "session", "law", "own", "determined", "worst",
               "right", "terms", "rejected", "seconds")
"""Columns of the table; errors are RMS over the judged signals in units of each signal's sensor noise.

`determined`: 1 if the effect's own hypothesis passes the test of a term on held-out cycles."""


def right_parts(effect: str) -> set[str]:
    """Return the parts of the bench that a law about an effect may name: of its hypothesis and of its constants."""
    names = truths.alike(effect)
    freed = {name for e in names for v in HYPOTHESES[e].variants(_middle()) for d in v.directions for name in d.along}
    return {HYPOTHESES[e].part for e in names} | {PATH_CARRIERS[n].part for n in freed if n in PATH_CARRIERS} | (
        {SENSOR} if "end_gain" in names else set())


def _middle() -> dict[str, float]:
    return CONSTANTS.named(np.zeros(len(CONSTANTS)))


def _determined(effect: str) -> bool:
    """Return whether an effect frees a constant that is none of the session's."""
    return any(extra_constants(CONSTANTS, [v]) for v in HYPOTHESES[effect].variants(_middle()))


def row(kind: str, asked: Question) -> dict[str, Any]:
    """Return one row: what the law reaches, and what the effect's own hypothesis or the exact change would."""
    name = asked.hidden[0]
    made = stored(Question(asked.structure, ("null",), asked.seed) if name in ADDED else asked)
    columns = made.trial
    if name in ADDED:
        columns = ADDED[name](dict(columns), np.random.default_rng(asked.seed))
    separation = made.separation
    if asked.effects:
        separation *= ENLARGED**2
        columns = {**columns, **{n: columns[n] + (ENLARGED - 1.0) * clean
                                 for n, clean in zip((START, END), made.clean, strict=True)}}
    with threadpool_limits(1, user_api="blas"):
        finder = EvidenceFinder([table(f"healthy{k}", c) for k, c in enumerate(made.references)])
        given = table("trial", columns)
        reference, observed, tables, known = finder.observed([given])
        searching = time.process_time()
        laws = discover(reference, observed, tables, known)
        seconds = time.process_time() - searching
        noise = {n: _noise(given, n) for n in (START, END)}

        def weighed(errors: Mapping[str, Figures], which: str) -> float:
            return float(np.sqrt(np.mean([(getattr(errors[n], f"rmse_{which}") / noise[n]) ** 2 for n in noise])))

        own, determined = "", ""
        if asked.effects:
            search = LawSearch(
                observed, reference.prior_of(observed), reference, blocks_of(tables, observed.trials), known)
            errors, fault = _own(search, tables, asked.effects[0])
            own, determined = f"{weighed(errors, 'after'):.4g}", str(int(not fault))
        elif name not in ADDED and made.clean.any():
            exact = {**columns, **{n: columns[n] - clean for n, clean in zip((START, END), made.clean, strict=True)}}
            own = f"{weighed(discover_none(finder, table('trial', exact)), 'session'):.4g}"
        elif name in ADDED:
            own = f"{weighed(discover_none(finder, table('trial', made.trial)), 'session'):.4g}"
    shapes = [(t.carrier, t.modulation) for t in laws.terms]
    right = (laws.terms[0].part in right_parts(asked.effects[0]) if asked.effects else
             any(m in FORMS.get(name, ()) for _, m in shapes)) if laws.terms else False
    worst = max((f.rmse_after or 0.0) / (f.rmse_session or 1.0) for f in laws.errors.values())
    return dict(zip(HEAD, (kind, asked.structure, name, asked.seed, f"{separation:.0f}",
                           f"{weighed(laws.errors, 'session'):.4g}", f"{weighed(laws.errors, 'after'):.4g}", own,
                           determined, f"{worst:.4g}", int(right), " + ".join(f"{c} × {m}" for c, m in shapes),
                           laws.rejected, f"{seconds:.1f}"), strict=True))


def _noise(given: Table, name: str) -> float:
    """Return 1σ of a signal's sensor noise on the data's bins."""
    from estimation.path_model import PATH_MODEL

    own = PATH_MODEL.record(replace(given, columns={n: v for n, v in given.columns.items() if n != END})) \
        if name == START else PATH_MODEL.record(given)
    return float(own.noise_n[name])


def _own(search: LawSearch, tables: Sequence[Table], effect: str) -> tuple[Mapping[str, Figures], str]:
    """Return the held-out errors with the effect's own hypothesis, and why it fails the test of a term.

    The hypothesis is the likeliest variant; the folds are those of a law.
    """
    base, observed = search.base, search.observed
    bench = observed.model.constants.named(search.prior.origin)
    fitted = [mode(observed, search.prior, [v], begun(base, v, screened(base, observed, v)[1]))
              for v in HYPOTHESES[effect].variants(bench)]
    at = max(fitted, key=lambda m: m.log_evidence)
    session, after = (search.predicted([], fit) for fit in (search.base, at))
    errors = HeldOut(observed, search.reference.missed(observed), session, after,
                     blocks_of(tables, observed.trials)).figures(search.reference)
    return errors, unconfirmed(errors, search.errors.least_falls(session - after))


def discover_none(finder: EvidenceFinder, given: Table) -> Mapping[str, Figures]:
    """Return the held-out errors with the session adapted alone."""
    reference, observed, tables, known = finder.observed([given])
    blocks = blocks_of(tables, observed.trials)
    search = LawSearch(observed, reference.prior_of(observed), reference, blocks, known)
    session = search.predicted([], search.base)
    return HeldOut(observed, reference.missed(observed), session, None, blocks).figures(reference)


def summary(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return the figures over rows, each with the number of cases in which it holds."""
    left = [r for r in rows if r["kind"] == "left_out" and r["determined"] == "1"]
    outside = [r for r in rows if r["kind"] == "outside"]
    healthy = [r for r in rows if r["kind"] == "healthy"]

    def share(r: Mapping[str, Any]) -> float:
        return (float(r["session"]) - float(r["law"])) / max(float(r["session"]) - 1.0, 1e-9)

    def attained(r: Mapping[str, Any]) -> float:
        return (float(r["session"]) - float(r["law"])) / max(float(r["session"]) - float(r["own"]), 1e-9)

    lines = [
        ("left out: the effect's own hypothesis passes the test of a term",
         [r["determined"] == "1" for r in rows if r["kind"] == "left_out"]),
        ("of these: law reaches 80 % of the effect's gain over the session", [attained(r) >= 0.8 for r in left]),
        ("of these: right part", [r["right"] == "1" for r in left]),
        ("outside: 2/3 of the way from session to sensor noise", [share(r) >= 2 / 3 for r in outside]),
        ("outside: 2/3 of the way to the error of no change", [attained(r) >= 2 / 3 for r in outside if r["own"]]),
        ("outside: form right", [r["right"] == "1" for r in outside]),
        ("healthy: with a term", [bool(r["terms"]) for r in healthy]),
        ("any output worse by more than 5 %", [float(r["worst"]) > 1.05 for r in rows])]
    return [(name, f"{sum(held)} of {len(held)}") for name, held in lines if held]


def page(rows: Sequence[Mapping[str, Any]], command: str) -> str:
    """Return the text between the marks of docs/laws.md."""
    kinds = {"left_out": "left out", "outside": "outside", "healthy": "reference"}
    cases = [(kinds[r["kind"]], r["structure"], truths.EFFECTS.get(r["hidden"], r["hidden"]).replace("_", " "),
              r["session"], r["law"], r["own"] or "–", r["terms"].replace("_", " ") or "–",
              ("yes" if r["right"] == "1" else "no") if r["terms"] and r["kind"] != "healthy" else "–")
             for r in sorted(rows, key=lambda r: (r["kind"], r["structure"], r["hidden"]))
             if r["terms"] or r["kind"] != "healthy"]
    return "\n\n".join((f"`{command}`:", markdown(["asked", "held"], summary(rows)), markdown(
        ["kind", "rig", "hidden", "error, session", "with the law", "with the effect or without the change", "terms",
         "right"], cases)))


def questions(structure: str, first: int, left: int, outside: int, healthy: int) -> list[tuple[str, Question]]:
    """Return the cases of one structure: each effect in turn, each outside change in turn, trials without a change."""
    effects = [name for name, effect in truths.EFFECTS.items() if _determined(effect)]
    others = [*truths.OUTSIDE, *ADDED]
    return [
        *(("left_out", Question(structure, (effects[i % len(effects)],), first + i)) for i in range(left)),
        *(("outside", Question(structure, (others[i % len(others)],), first + 500 + i)) for i in range(outside)),
        *(("healthy", Question(structure, (("null", "null_alt")[i % 2],), first + 700 + i)) for i in range(healthy))]


def main(arguments: list[str]) -> None:
    """Ask every case that the table does not have, and print each row and the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, count in (("--first", 96000), ("--left-out", 20), ("--outside", 10), ("--healthy", 10)):
        parser.add_argument(name, type=int, default=count)
    parser.add_argument("--structures", default=",".join(truths.STRUCTURES))
    parser.add_argument("--rows", type=Path, default=Path("out/laws.csv"))
    parser.add_argument("--page", action="store_true")
    given = parser.parse_args(arguments)
    given.rows.parent.mkdir(parents=True, exist_ok=True)
    if not given.rows.exists():
        given.rows.write_text(",".join(HEAD) + "\n", encoding="utf-8")
    asked = [case for turn in zip(*(questions(s, given.first, given.left_out, given.outside, given.healthy)
                                    for s in given.structures.split(",")), strict=True) for case in turn]
    asked.sort(key=lambda case: case[1].seed % 20)  # kinds in turn, so that a part of the table is a sample
    with given.rows.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    done = {(r["structure"], r["hidden"], int(r["seed"])) for r in rows}
    with given.rows.open("a", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, HEAD, lineterminator="\n")
        for kind, question in asked:
            if (question.structure, question.hidden[0], question.seed) in done:
                continue
            made = row(kind, question)
            out.writerow(made)
            file.flush()
            print(*made.values(), sep=" | ", flush=True)
            rows.append({name: str(value) for name, value in made.items()})
    print("\n".join(f"{name}: {held}" for name, held in summary(rows)))
    if given.page:
        asked_for = f"--first {given.first} --left-out {given.left_out} --outside {given.outside}"
        put(DOCS / "laws.md", "laws", page(rows, f"python -m tests.hidden.laws_run {asked_for} --healthy "
                                                 f"{given.healthy}"))


if __name__ == "__main__":
    main(sys.argv[1:])
