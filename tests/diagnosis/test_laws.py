"""Laws: changes that no effect of the catalogue describes are found as terms, with size, place in time and gain.

The trials are of `tests.plants`, whose structure the forward model does not share; what is added to END is exact.
"""

from __future__ import annotations

import copy
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from diagnosis.compared_signals import Figures
from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.evidence.held_out import blocks_of
from diagnosis.finder import Finder
from diagnosis.findings import Findings
from diagnosis.laws.law_findings import worse
from diagnosis.laws.law_result import Laws
from diagnosis.laws.model_error import ModelErrors
from estimation.data.table import Table
from parameters import InputError
from physics.plant import PlantParameters, imposed
from physics.plant.bench_plant import BowdenPlant
from physics.terms import MODULATIONS, Course, Term, rows, stated
from tests.hidden import family
from tests.hidden.family import Job
from virtual_bus.machine import plant_model

Change = Callable[[Table], np.ndarray]


def term(carrier: str, modulation: str, parameters: dict[str, float], *coefficients: float, unit: str = "") -> Term:
    return Term(carrier, modulation, parameters, coefficients, tuple((a - 0.1, a + 0.1) for a in coefficients), unit,
                "sensor", "gain of END")


TERMS = [
    term("end_gain", "step", {"at_s": 4.0}, 0.06),
    term("end_offset", "time_sine", {"hz": 13.0}, 1.0, 0.5, unit="N"),
    term("cable", "position_sine", {"radius_m": 0.02}, 0.3, -0.1),
    term("zero", "knee_bump", {"at_rad": -0.6, "width_rad": 0.05}, 1e-3, unit="m"),
]


def test_terms_in_a_file_are_read_back() -> None:
    import tomllib

    assert stated(tomllib.loads("\n".join(rows(TERMS))), "x.toml") == tuple(TERMS)


@pytest.mark.parametrize(("change", "sentence"), [
    ({"modulation": "wobble"}, "modulation = 'wobble'; expected one of constant"),
    ({"parameters": {}}, "parameters none; expected at_s of step"),
    ({"coefficients": []}, "expected finite numbers and 1 coefficients"),
    ({"parameters": {"at_s": float("nan")}}, "expected finite numbers"),
])
def test_a_wrong_term_is_refused_with_its_place(change: dict[str, object], sentence: str) -> None:
    import tomllib

    row = tomllib.loads("\n".join(rows(TERMS[:1])))["terms"][0]
    with pytest.raises(InputError, match=r"x\.toml \[\[terms\]\] 1") as caught:
        stated({"terms": [{**row, **change}]}, "x.toml")
    assert sentence in str(caught.value)


def test_equations_have_units_and_an_interval() -> None:
    assert term("end_gain", "step", {"at_s": 6.44}, -0.0585).equation == (
        "gain of END × (1 − 0.0585 from t = 6.44 s on), size −0.159 … 0.0415")
    assert "sin(2π·13 Hz·t + 0.46)" in TERMS[1].equation


def test_every_modulation_is_finite_on_a_course() -> None:
    time = np.linspace(0.0, 4.0, 400)
    course = Course(time, 0.03 * np.sin(time), 0.03 * np.cos(time), 20.0 + 10.0 * np.sin(time), -0.5 + 0.1 * time,
                    time % 1.0)
    for shape in MODULATIONS.values():
        parts = shape.function(course, dict.fromkeys(shape.parameters, 0.5))
        assert len(parts) == shape.components
        assert all(part.shape == time.shape and np.isfinite(part).all() for part in parts)


@pytest.mark.slow
def test_the_plant_follows_terms_of_its_parameters_and_sensors() -> None:
    time = np.arange(0.0, 2.0, 1e-3)
    moved = imposed.motion(time, 0.012 * (1.0 - np.cos(np.pi * time)), np.full(time.size, -0.5))
    plain = imposed.simulate(PlantParameters(), moved)
    gained = imposed.simulate(PlantParameters(), moved, [term("end_gain", "constant", {}, 0.1)])
    assert np.allclose(gained.end_n, 1.1 * plain.end_n)
    assert np.array_equal(gained.start_n, plain.start_n)
    mu1 = imposed.simulate(dataclasses.replace(PlantParameters(), mu1=1.5 * PlantParameters().mu1), moved)
    rubbed = imposed.simulate(PlantParameters(), moved, [term("cable", "constant", {}, 0.5)])
    assert np.abs(rubbed.end_n - mu1.end_n).max() < 1e-9  # the same bench, from the first step on
    none = imposed.simulate(PlantParameters(), moved, [term("cable", "decay", {"tau_s": 1.0}, 0.5)])
    assert np.array_equal(none.end_n, plain.end_n)  # a decay is over in a later trial


def test_a_term_that_the_plant_cannot_follow_is_refused() -> None:
    phase = term("end_offset", "phase_bump", {"phase": 0.5, "width": 0.02}, 1.0, unit="N")
    with pytest.raises(InputError, match=r"m\.toml: the simulated bench cannot follow a term of end_offset by phase_"):
        BowdenPlant(PlantParameters()).extend([phase], "m.toml")


def test_a_plant_model_carries_the_terms_of_its_file(tmp_path: Path) -> None:
    file = tmp_path / "extended.toml"
    file.write_text("\n".join(rows(TERMS)), encoding="utf-8")
    from eds.declaration import PathNodes

    assert plant_model.read(file, PathNodes(1, 2, 3, 4)).terms == tuple(TERMS)


def loaded_s(trial: Table) -> float:
    """Return a time at which END carries force: without force nothing shows when END's gain changes."""
    passed = np.cumsum(trial["tension_end_n"])
    return float(trial["time_s"][np.searchsorted(passed, 0.6 * passed[-1])])


def stepped(trial: Table) -> np.ndarray:
    return np.asarray(trial["tension_end_n"] * np.where(trial["time_s"] >= loaded_s(trial), 1.07, 1.0))


def vibrating(trial: Table) -> np.ndarray:
    return np.asarray(trial["tension_end_n"] + 1.2 * np.sin(2.0 * np.pi * 11.3 * trial["time_s"]))


def pulsing(trial: Table) -> np.ndarray:
    return np.asarray(trial["tension_end_n"] + 3.0 * np.exp(-0.5 * ((trial["gait_percent"] - 62.0) / 1.5) ** 2))


def saturated(trial: Table) -> np.ndarray:
    top = trial["tension_end_n"].max()
    return np.asarray(np.minimum(trial["tension_end_n"], 0.75 * top))


@pytest.fixture(scope="module")
def recorded() -> tuple[Finder, Table]:
    case = family.case(Job(8801, ()))
    return Finder().fit(case.healthy), case.trial


def changed(trial: Table, change: Change) -> Table:
    return dataclasses.replace(trial, columns={**trial.columns, "tension_end_n": change(trial)})


@pytest.mark.exhaustive
def test_a_change_that_repeats_in_each_cycle_must_exceed_the_discrepancy() -> None:
    made = family.case(Job(8801, ()))
    reference, observed, tables, known = EvidenceFinder(list(made.healthy)).observed([made.trial])
    blocks, phase = blocks_of(tables, observed.trials), observed.trials[0].phase
    assert phase is not None
    errors = ModelErrors(observed, reference.prior_of(observed), reference, blocks, known)
    pulse = np.exp(-0.5 * ((phase - 0.6) / 0.02) ** 2)
    every, other = (np.tile(pulse * sign, len(observed.outputs)) for sign in (1.0, np.where(blocks[0] % 2, 1.0, -1.0)))
    least = errors.least_falls(every)
    assert all(least[name] > 1.5 * fall for name, fall in errors.least_falls(other).items())
    # where the model misses the reference trials by a newton, a term must take more than that
    missed = [copy.copy(trial) for trial in known]
    for trial in missed:
        assert trial.phase is not None
        trial.data = trial.data + np.tile(np.exp(-0.5 * ((trial.phase - 0.6) / 0.04) ** 2), len(observed.outputs))
    seen = ModelErrors(observed, reference.prior_of(observed), reference, blocks, missed).least_falls(every)
    assert all(seen[name] > fall + 0.3 for name, fall in least.items())


@pytest.mark.parametrize(("name", "rmse", "high", "harmed"), [
    ("tension_end_n", 1.06, -1.0, True), ("tension_end_n", 1.04, -1.0, False),
    ("servo_force_n", 1.06, -1.0, False), ("servo_force_n", 1.16, -10.0, True),
])
def test_harm_to_a_signal_that_is_not_judged_needs_whole_cycles(name: str, rmse: float, high: float, harmed: bool
                                                               ) -> None:
    errors = {name: Figures("N", rmse_session=1.0, rmse_after=rmse, high=high)}
    assert bool(worse(errors, ("tension_end_n", "tension_start_n"))) is harmed


@pytest.mark.exhaustive
def test_a_law_by_gait_phase_is_found_beside_rows_outside_the_gait(recorded: tuple[Finder, Table]) -> None:
    # a rest between two walks, as in the experiment rest_repeat
    finder, trial = recorded
    rest = np.abs(trial["time_s"] - 4.0) < 0.7
    end, phase = np.where(rest, trial["tension_end_n"], pulsing(trial)), np.where(rest, np.nan, trial["gait_percent"])
    laws, _ = finder.discover([dataclasses.replace(
        trial, columns={**trial.columns, "tension_end_n": end, "gait_percent": phase})])
    assert laws.terms[0].modulation == "phase_bump"
    assert laws.terms[0].parameters["phase"] == pytest.approx(0.62, abs=0.03)


@pytest.mark.exhaustive
def test_a_healthy_trial_has_no_law(recorded: tuple[Finder, Table]) -> None:
    finder, trial = recorded
    assert not finder.discover([trial])[0].terms


def test_an_answer_has_keys_of_terms_only_if_terms_were_sought() -> None:
    plain = Findings("unexplained")
    assert not {"terms", "law"} & plain.as_json().keys()
    sought = dataclasses.replace(plain, laws=Laws(TERMS, [1.0] * 4, {}, [], 10)).as_json()
    assert [one["carrier"] for one in sought.pop("terms")] == [one.carrier for one in TERMS]
    assert sought.pop("law")["library"] == 10
    assert sought == plain.as_json()


@pytest.mark.exhaustive
def test_a_diagnosis_seeks_terms_where_effects_do_not_explain_the_trial(recorded: tuple[Finder, Table]) -> None:
    finder, trial = recorded
    for given in (trial, changed(trial, vibrating)):
        plain, sought = (finder.diagnose([given], terms=terms).as_json() for terms in (False, True))
        terms = [term["modulation"] for term in sought.pop("terms", [])]
        sought.pop("law", None)
        assert sought == plain
        assert terms == (["time_sine"] if plain["unexplained"] else [])


@pytest.mark.exhaustive
@pytest.mark.parametrize(("change", "carriers", "modulation", "parameter", "value"), [
    (stepped, {"end_gain"}, "step", "at_s", None), (vibrating, {"end_offset"}, "time_sine", "hz", 11.3),
    # while the rope moves one way, friction without load changes END as its offset does: 0.1 of 1,507 nats between them
    (pulsing, {"end_offset", "end_gain", "dry"}, "phase_bump", "phase", 0.62),
    (saturated, {"end_offset", "end_gain"}, "saturation", "from_n", None),
])
def test_a_change_outside_the_catalogue_is_a_law_with_its_place(
        recorded: tuple[Finder, Table], change: Change, carriers: set[str], modulation: str, parameter: str,
        value: float | None) -> None:
    finder, trial = recorded
    laws, bench = finder.discover([changed(trial, change)])
    first, errors = laws.terms[0], laws.errors["tension_end_n"]
    assert (first.carrier in carriers, first.modulation) == (True, modulation), first.equation
    expected = loaded_s(trial) - trial["time_s"][0] if parameter == "at_s" else value
    if expected is not None:
        assert abs(first.parameters[parameter] - expected) < 0.03 * max(expected, 1.0), first.equation
    assert errors.rmse_after < errors.rmse_session / 2.0
    assert bench is not None
    json.dumps(laws.as_json(), allow_nan=False)
