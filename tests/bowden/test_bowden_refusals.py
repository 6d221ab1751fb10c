"""Bad input: one sentence on stderr, exit status 2, nothing on stdout, nothing left behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

TRIAL = ("trial", "-o", "out.mcap")
CSV = {
    "nan.csv": "time_s,knee_angle_rad\n" + "".join(f"{i / 10},{'nan' if i == 4 else -0.3}\n" for i in range(12)),
    "back.csv": "time_s,knee_angle_rad\n" + "".join(f"{i % 6 / 10},-0.3\n" for i in range(12)),
    "empty.csv": "",
    "header.csv": "t,angle\n0,1\n",
    "words.csv": "time_s,knee_angle_rad\n0,bent\n",
}
TOML = {
    "key.toml": "[network]\nrate = 500\n",
    "range.toml": "[limits]\nstart_n = -1\n",
    "type.toml": "[network]\nrate_hz = 1e3\n",
    "table.toml": "[netwrok]\nrate_hz = 500\n",
    "broken.toml": "[network\n",
}
CASES = [
    (("--peak", "forty"), "--peak"),
    (("--peak", "nan"), "--peak"),
    (("--peak", "-3"), "--peak"),
    (("--peak", "89"), "--peak"),
    (("--period", "0"), "--period"),
    (("--cycles", "0"), "--cycles"),
    (("--cycles", "2", "--settle", "2"), "--settle"),
    (("--rate", "333"), "rate_hz"),
    (("--rate", "2000"), "rate_hz"),
    (("--bitrate", "123456"), "bitrate"),
    (("--controller", "magic"), "controller"),
    (("--serial", "-1"), "serial"),
    (("--plant", "nowhere"), "nowhere"),
    (("--plant-model", "none.toml"), "none.toml"),
    (("--nonsense",), "--nonsense"),
    (("--interface", "nonsense", "--channel", "x"), "nonsense"),
    (("--interface", "virtual", "--serial", "2"), "--serial"),
    (("--option", "fd"), "--option fd"),
    (("--calibration", "none.toml"), "none.toml"),
    (("--config", "none.toml"), "none.toml"),
    *(((("--config", name)), name) for name in TOML),
    (("--knee", "none.csv"), "none.csv"),
    *(((("--knee", name)), name) for name in CSV),
    (("--desired", "nan.csv"), "nan.csv"),
    (("--picture", "out.mcap"), "out.mcap"),
    (("--picture", "gone/x.png"), "gone"),
]


@pytest.fixture
def filled(here: Path) -> Path:
    """A working directory with every bad file of this module."""
    for name, text in {**CSV, **TOML}.items():
        (here / name).write_text(text)
    return here


@pytest.mark.parametrize(("options", "named"), CASES, ids=[" ".join(options) for options, _ in CASES])
def test_bad_input_is_refused_in_one_sentence(
    filled: Path, bowden: Callable[..., tuple[int, str, str]], options: tuple[str, ...], named: str
) -> None:
    before = sorted(filled.iterdir())
    status, out, err = bowden(*TRIAL, *options)
    assert (status, out) == (2, "")
    said = [line for line in err.splitlines() if "compiled the laws" not in line]  # a machine's first run says so
    assert len(said) == 1
    assert said[0].startswith("bowden: ")
    assert named in said[0]
    assert sorted(filled.iterdir()) == before


@pytest.mark.parametrize(("text", "sentence"), [
    ("=5", "--option =5: has no key; write KEY=VALUE"),
    ("rate_hz=500", "rate_hz = 500: is no option of the simulated bench; state it by --rate"),
    ("truth=t.mcap", "a recorded trial writes its own truth file"),
    ("plant_model=5", "plant_model = 5 is no file, table or bench model; name a TOML file"),
    ("faults=5", "faults = 5 is not a text or a list; faults of the wire: a TOML file"),
    ("steady=5", "steady = 5 is not a text or a list"),
    ("hand=5", "hand = 5 is not a table"),
    ("hand=knee", "hand = 'knee' is not a table"),
    ("sto_us=soon", "sto_us = 'soon' is not a whole number"),
])
def test_a_bad_option_of_the_simulated_bus_names_key_value_and_what_was_expected(
    here: Path, bowden: Callable[..., tuple[int, str, str]], text: str, sentence: str
) -> None:
    status, out, err = bowden(*TRIAL, "--interface", "bowden", "--option", text)
    assert (status, out) == (2, "")
    assert sentence in err
    assert not list(here.iterdir())


@pytest.mark.parametrize("name", ["out.mcap", "out.truth.mcap"])
def test_an_existing_output_is_kept(here: Path, bowden: Callable[..., tuple[int, str, str]], name: str) -> None:
    (here / name).write_bytes(b"kept")
    status, out, err = bowden(*TRIAL)
    assert (status, out) == (2, "")
    assert f"{name}: the file exists" in err
    assert (here / name).read_bytes() == b"kept"


@pytest.mark.parametrize("path", ["folder", "gone/out.mcap"])
def test_an_output_that_cannot_be_written_is_refused(
    here: Path, bowden: Callable[..., tuple[int, str, str]], path: str
) -> None:
    (here / "folder").mkdir()
    status, out, err = bowden("trial", "-o", path)
    assert (status, out) == (2, "")
    assert path.split("/")[0] in err
    assert [item.name for item in here.iterdir()] == ["folder"]


def test_no_output_is_a_sentence_too(bowden: Callable[..., tuple[int, str, str]]) -> None:
    assert bowden("trial")[0] == 2
