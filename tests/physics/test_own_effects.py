"""Effects of a user's own: expressions are interpreted safely, and a wrong file gets one sentence."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from estimation.own_effects_model import with_own_effects
from estimation.path_model import PATH_MODEL
from parameters import InputError
from physics import expressions
from physics.effects import catalogue, own_effects
from physics.terms import Course, Term, rows, stated

pytestmark = pytest.mark.usefixtures("plain_catalogue")
FILE = """
[effects.end_loses_gain]
words = "END loses gain at high load."
carrier = "end_gain"
expression = "max(tension_n - from_n, 0) / 30"
parameters = { size = { low = -0.9, high = 0.9, likely = [-0.3, 0.3] }, from_n = { low = 5, high = 60 } }
"""


@pytest.mark.parametrize("text", [
    "__import__('os').system('true')", "tension_n.__class__", "[tension_n for tension_n in (1,)]", "lambda: 1", "'a'",
    "open('/etc/passwd')", "max(tension_n, key=1)", "max(*[1, 2])", "True", "tension_n if 1 else 2", "1 < 2 < 3", "1j",
    "(" * 400 + "1" + ")" * 400, "tension_n +", "sin(1, 2)", "unknown + 1", "tension_n[0]", "f'{tension_n}'",
    "tension_n := 2"])
def test_nothing_but_arithmetic_of_known_names_is_an_expression(text: str) -> None:
    with pytest.raises(InputError, match=r"^x\.toml: "):
        expressions.names_of(text, {"tension_n"}, "x.toml")


def test_an_expression_is_the_function_that_it_reads_as() -> None:
    tension = np.linspace(0.0, 50.0, 6)
    text = "max(tension_n - from_n, 0) / 30 * (tension_n > 25) - 2 ** -1 * sin(0 * tension_n)"
    assert expressions.names_of(text, {"tension_n", "from_n"}, "x") == {"tension_n", "from_n"}
    found = expressions.compiled(text)({"tension_n": tension, "from_n": 20.0})
    assert np.allclose(found, np.where(tension > 25.0, np.maximum(tension - 20.0, 0.0) / 30.0, 0.0))
    assert expressions.compiled("9 ** 9 ** 9 ** 9")({}) == 0.0  # overflows to no number, at once


def test_a_file_becomes_an_effect_of_the_catalogue_once(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(FILE, encoding="utf-8")
    assert own_effects.read(file) == own_effects.read(file) == ["end_loses_gain"]
    effect = catalogue.CATALOGUE["end_loses_gain"]
    assert (effect.site, [p.name for p in effect.parameters]) == ("END sensor", ["size", "from_n"])
    file.write_text(FILE.replace("0.9", "0.8"), encoding="utf-8")
    with pytest.raises(InputError, match="the catalogue has an effect end_loses_gain"):
        own_effects.read(file)


@pytest.mark.parametrize(("old", "new", "sentence"), [
    ("end_gain\"", "gain\"", "carrier = 'gain'; expected one of zero"),
    ("from_n, 0)", "from_m, 0)", "unknown name from_m; expected from_n"),
    ("(tension_n - from_n, 0)", "(tension_n, 0)", "has no from_n; remove the parameter"),
    ("low = 5, high = 60", "low = 60, high = 5", "expected low ≤ likely"),
    ("low = 5", "low = 'a'", "with finite numbers"),
    ("low = -0.9", "low = 0.1, likely = [0.2, 0.3]", "read as TOML"),
    ("size =", "amount =", "parameters need size"),
    ("expression", "modulation", "expected one of constant"),
    ("words", "word", "expected words, carrier, parameters"),
    ("[effects.", "[effect.", "declares no effect")])
def test_a_wrong_file_gets_one_sentence(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    file = tmp_path / "own.toml"
    file.write_text(FILE.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=r"own\.toml") as caught:
        own_effects.read(file)
    if sentence != "read as TOML":
        assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not own_effects.OWN


def test_a_term_by_an_expression_is_read_back_and_follows_its_course(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(FILE, encoding="utf-8")
    own_effects.read(file)
    term = own_effects.OWN["end_loses_gain"].term({
        "size": {"value": -0.2, "low": -0.3, "high": -0.1}, "from_n": {"value": 20.0, "low": 19.0, "high": 21.0}})
    assert stated(tomllib.loads("\n".join(rows([term]))), "x.toml") == (term,)
    tension = np.linspace(0.0, 50.0, 6)
    still = np.zeros(6)
    course = Course(still, still, still, tension, None, None)
    assert np.allclose(term.changed(1.0, course), 1.0 - 0.2 * np.maximum(tension - 20.0, 0.0) / 30.0)


def test_a_promoted_law_is_a_file_of_effects(tmp_path: Path) -> None:
    found = [Term("end_gain", "saturation", {"from_n": 24.0}, (-0.2,), ((-0.3, -0.1),), "", "sensor", "gain of END"),
             Term("end_offset", "time_sine", {"hz": 13.0}, (1.0, -0.5), ((0.9, 1.1), (-0.6, -0.4)), "N", "sensor",
                  "END"),
             Term("zero", "knee_bump", {"at_rad": -0.6, "width_rad": 0.05}, (1e-3,), ((0.0, 2e-3),), "m", "geometry",
                  "zero of the rope")]
    file = tmp_path / "own.toml"
    file.write_text(own_effects.promoted(found), encoding="utf-8")
    assert own_effects.read(file) == ["end_gain_saturation", "end_offset_time_sine", "zero_knee_bump"]


def test_an_effect_competes_only_where_it_is_named(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(FILE, encoding="utf-8")
    (name,) = own_effects.read(file)
    assert name in with_own_effects(PATH_MODEL, [name]).hypotheses
    assert with_own_effects(PATH_MODEL) is PATH_MODEL
