"""Writes constraints.hashes.txt: the versions of constraints.txt, each with the SHA-256 of its file.

`python -m tests.hashes` asks pip for the files of this interpreter and platform; tests/test_pinned_files.py compares.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
HEAD = """\
# constraints.txt with the SHA-256 of each file for CPython 3.11 on Linux x86-64; `python -m tests.hashes` writes it.
# pip install --require-hashes --no-deps -r constraints.hashes.txt
"""


def normal(name: str) -> str:
    """Return a project's name as packaging normalises it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def main() -> None:
    """Ask pip for every pinned file and write the list."""
    pinned = ROOT / "constraints.txt"
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.json")
        subprocess.run([sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--no-deps",
                        "--quiet", "-r", pinned, "--report", report], check=True)
        found = {normal(one["metadata"]["name"]): one["download_info"]["archive_info"]["hashes"]["sha256"]
                 for one in json.loads(report.read_text(encoding="utf-8"))["install"]}
    lines = [f"{line} --hash=sha256:{found[normal(line.partition('==')[0])]}\n"
             for line in pinned.read_text(encoding="utf-8").splitlines()]
    (ROOT / "constraints.hashes.txt").write_text(HEAD + "".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
