"""Files that are installed have a hash: constraints.hashes.txt, the npm lock file, the CI's actions by commit."""

from __future__ import annotations

import json
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOREIGN = ROOT / "tests" / "foreign"


def test_every_pinned_version_has_the_hash_of_its_file() -> None:
    pinned = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    hashed = [line for line in (ROOT / "constraints.hashes.txt").read_text(encoding="utf-8").splitlines()
              if not line.startswith("#")]
    assert [line.partition(" ")[0] for line in hashed] == pinned
    assert [line for line in hashed if not re.fullmatch(r"\S+ --hash=sha256:[0-9a-f]{64}", line)] == []


def test_the_npm_lock_file_has_every_hash_and_no_address_of_a_registry() -> None:
    asked = json.loads((FOREIGN / "package.json").read_text(encoding="utf-8"))
    packages = json.loads((FOREIGN / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    root = packages.pop("")
    assert {name: root.get(name) for name in ("dependencies", "optionalDependencies")} == {
        name: asked[name] for name in ("dependencies", "optionalDependencies")}
    assert [name for name, told in packages.items() if "integrity" not in told or "resolved" in told] == []


def test_the_actions_of_the_ci_are_named_by_commit() -> None:
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    used = re.findall(r"uses: (\S+)", text)
    assert used
    assert [name for name in used if not re.search(r"@[0-9a-f]{40}$", name)] == []


def test_the_ci_installs_by_hashes() -> None:
    """Before `make` could install anything: the marks of its own installation are set."""
    text = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    hashed = text.index("--require-hashes --no-deps -r constraints.hashes.txt")
    assert hashed < text.index("touch .venv/.installed .venv/.installed-test") < text.index("make test")
