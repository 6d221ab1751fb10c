"""Mutation check of the devices: one mutant for each row of a transition table, each abort code, each EMCY code.

    python tests/mutation_check.py [--only TEXT] [--list] [--workers N] > results
    python tests/mutation_check.py --results results --page docs/devices.md

The rule of this file: a mutant that no test notices is listed, and unless `EXPLAINED` says why it cannot be noticed the
exit status is 1.  Each mutant lives in a process of its own, made at import; no source is written.
"""

from __future__ import annotations

import argparse
import ast
import importlib.abc
import importlib.machinery
import importlib.util
import os
import re
import resource
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
HANGS_CPU_S = 120
HANGS_WALL_S = 1800
"""When a mutant hangs: processor time where it computes; wall time, generous for a busy machine, where it waits."""
REPLACEMENT = {"Abort": "NO_DICTIONARY", "Emcy": "SOFTWARE"}
"""Codes that no device uses: they stand in for the right one."""

EXPLAINED: dict[str, str] = {}
"""Mutant → why no frame can tell it from the original."""

KINDS = {
    "row of CiA 402's table": " TRANSITIONS ",
    "row of 0x1029's table": " ON_ERROR ",
    "SDO abort code": " Abort.",
    "EMCY error code": " Emcy.",
    "row of the NMT table": " × ",
    "service in an NMT state": " in ",
}
"""What a mutant changes → what its name has."""


@dataclass(frozen=True)
class Mutant:
    """One change: to a module's syntax tree before it runs, or to the module after."""

    name: str
    module: str
    tests: tuple[str, ...]
    change: Callable[[ast.Module], None] | None = None
    patch: Callable[[ModuleType], None] | None = None

    @property
    def explanation(self) -> str:
        """Why it cannot be noticed, "" where that is not known; line numbers do not count."""
        return EXPLAINED.get(re.sub(r":\d+ ", " ", self.name), "")


def mutants() -> Iterator[Mutant]:
    """Yield every mutant, in the order of the sources."""
    yield from _nmt_rows()
    yield from _services()
    yield from _rows("eds.cia402", "TRANSITIONS", "astray", _lead_astray, _tests("nodes", core=False))
    yield from _rows("nodes.core.nmt", "ON_ERROR", "absent", _take_out, _tests("nodes", core=True))
    for path in sorted((ROOT / "nodes").rglob("*.py")):
        yield from _codes(path)


def _tests(room: str, core: bool) -> tuple[str, ...]:
    names = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "tests" / room).glob("test_*.py"))
    return tuple(n for n in names if "fuzz" not in n and "docs" not in n and core is ("test_core_" in n))


def _nmt_rows() -> Iterator[Mutant]:
    for state in ("PRE_OPERATIONAL", "OPERATIONAL", "STOPPED"):
        for command in ("START", "STOP", "ENTER_PRE_OPERATIONAL", "RESET_NODE", "RESET_COMMUNICATION"):
            def patch(module: ModuleType, state: str = state, command: str = command) -> None:
                row = module.NmtState[state], module.NmtCommand[command]
                module.NMT_TRANSITIONS = {**module.NMT_TRANSITIONS,
                                          row: _other(module, row)}  # type: ignore[attr-defined]
            yield Mutant(f"eds.cia301 NMT {state} × {command}", "eds.cia301", _tests("nodes", core=True), patch=patch)


def _other(module: ModuleType, row: tuple[object, object]) -> object:
    states = module.NmtState
    return states.STOPPED if module.NMT_TRANSITIONS[row] is not states.STOPPED else states.OPERATIONAL


def _services() -> Iterator[Mutant]:
    for state in ("PRE_OPERATIONAL", "OPERATIONAL", "STOPPED"):
        for service in ("NMT", "ERROR_CONTROL", "SYNC", "EMCY", "SDO", "PDO"):
            def patch(module: ModuleType, state: str = state, service: str = service) -> None:
                at, turned = module.NmtState[state], {module.Service[service]}
                module.SERVICES = {**module.SERVICES, at: module.SERVICES[at] ^ turned}  # type: ignore[attr-defined]
            yield Mutant(f"eds.cia301 {service} in {state}", "eds.cia301", _tests("nodes", core=True), patch=patch)


def _rows(module: str, table: str, how: str, change_row: Callable[[ast.Tuple | ast.Dict, int], None],
          tests: tuple[str, ...]) -> Iterator[Mutant]:
    """Change each row of a tuple or dict that the module assigns to `table`."""
    rows = _table(ast.parse(_path(module).read_text(encoding="utf-8")), table)
    for number, text in enumerate(_row_names(rows)):
        def change(tree: ast.Module, number: int = number) -> None:
            change_row(_table(tree, table), number)
        yield Mutant(f"{module} {table} {how}: {text}", module, tests, change=change)


def _take_out(rows: ast.Tuple | ast.Dict, number: int) -> None:
    assert isinstance(rows, ast.Dict)
    del rows.keys[number], rows.values[number]


def _lead_astray(rows: ast.Tuple | ast.Dict, number: int) -> None:
    """Let a `Transition(number, sources, events, target, action)` lead elsewhere."""
    assert isinstance(rows, ast.Tuple)
    row = rows.elts[number]
    assert isinstance(row, ast.Call)
    target = row.args[3]
    assert isinstance(target, ast.Attribute)
    target.attr = "SWITCH_ON_DISABLED" if target.attr == "FAULT" else "FAULT"


def _row_names(rows: ast.Tuple | ast.Dict) -> list[str]:
    nodes: Sequence[ast.expr | None] = rows.keys if isinstance(rows, ast.Dict) else rows.elts
    return [ast.unparse(node)[:60] for node in nodes if node is not None]


def _table(tree: ast.Module, name: str) -> ast.Tuple | ast.Dict:
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == name:
            assert isinstance(node.value, ast.Tuple | ast.Dict)
            return node.value
    raise LookupError(name)


def _codes(path: Path) -> Iterator[Mutant]:
    """Replace each `Abort.X` and `Emcy.X` of a source, one at a time."""
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    tests = _tests("nodes", core="core" in path.parts)
    for number, node in enumerate(_uses(ast.parse(path.read_text(encoding="utf-8")))):
        def change(tree: ast.Module, number: int = number) -> None:
            use = _uses(tree)[number]
            use.attr = REPLACEMENT[use.value.id]  # type: ignore[attr-defined]
        name = f"{module}:{node.lineno} {ast.unparse(node)}"
        yield Mutant(name, module, tests, change=change)


def _uses(tree: ast.Module) -> list[ast.Attribute]:
    found = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute)
             and isinstance(node.value, ast.Name) and node.value.id in REPLACEMENT and node.attr.isupper()]
    return sorted(found, key=lambda node: (node.lineno, node.col_offset))


def _path(module: str) -> Path:
    return (ROOT / Path(*module.split("."))).with_suffix(".py")


class _Loader(importlib.machinery.SourceFileLoader):
    """Loads one module changed."""

    def __init__(self, mutant: Mutant) -> None:
        super().__init__(mutant.module, str(_path(mutant.module)))
        self._mutant = mutant

    def get_code(self, fullname: str) -> CodeType:
        tree = ast.parse(_path(fullname).read_text(encoding="utf-8"))
        if self._mutant.change is not None:
            self._mutant.change(tree)
        return compile(ast.fix_missing_locations(tree), self.path, "exec")

    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        if self._mutant.patch is not None:
            self._mutant.patch(module)


class _Finder(importlib.abc.MetaPathFinder):
    def __init__(self, mutant: Mutant) -> None:
        self._mutant = mutant

    def find_spec(self, fullname: str, path: object, target: object = None) -> importlib.machinery.ModuleSpec | None:
        if fullname != self._mutant.module:
            return None
        return importlib.util.spec_from_file_location(fullname, _path(fullname), loader=_Loader(self._mutant))


class _FirstFailure:
    """A pytest plugin that imports the mutant and remembers what noticed it."""

    name = ""

    def __init__(self, mutant: Mutant) -> None:
        self._finder = _Finder(mutant)

    @pytest.hookimpl(tryfirst=True)
    def pytest_load_initial_conftests(self) -> None:
        """Put the mutant before pytest's own import hook, which rewrites every module of a package with a plugin."""
        sys.meta_path.insert(0, self._finder)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.name:
            self.name = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self.name:
            self.name = f"{report.nodeid} (collection)"


def _noticed(mutant: Mutant) -> str:
    """Run the tests against `mutant` in this process; return what noticed it, "" for nothing."""
    failure = _FirstFailure(mutant)
    quick = ("-x", "-q", "-m", "not walltime", "-p", "no:cacheprovider", "-p", "no:xdist")
    status = pytest.main([*quick, *mutant.tests], plugins=[failure])
    return failure.name or ("" if status == 0 else f"pytest status {status}")


def _healthy(original: Mutant) -> None:
    """Refuse to judge mutants by tests that fail without one."""
    runs = [_start(original)]
    while runs:
        for _run, noticed in _finished(runs):
            if noticed:
                raise SystemExit(f"{noticed} fails without a mutant; mend that first.")


@dataclass
class _Run:
    mutant: Mutant
    process: int
    answer: int
    started: float


def _start(mutant: Mutant) -> _Run:
    answer, tell = os.pipe()
    process = os.fork()
    if process == 0:
        os.close(answer)
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (HANGS_CPU_S, HANGS_CPU_S))
        os.write(tell, (_noticed(mutant) or "-").encode())
        os._exit(0)
    os.close(tell)
    return _Run(mutant, process, answer, time.monotonic())


def _finished(runs: list[_Run]) -> Iterator[tuple[_Run, str]]:
    """Wait a moment; yield the runs that ended, or that hang, with what noticed their mutant."""
    ready, _, _ = select.select([run.answer for run in runs], [], [], 1.0)
    for run in list(runs):
        hangs = time.monotonic() - run.started > HANGS_WALL_S
        if run.answer not in ready and not hangs:
            continue
        text = "it hangs" if hangs else os.read(run.answer, 4096).decode() or "it crashes or hangs"
        os.kill(run.process, signal.SIGKILL)
        os.waitpid(run.process, 0)
        os.close(run.answer)
        runs.remove(run)
        yield run, "" if text == "-" else text


def check(chosen: Sequence[Mutant], workers: int) -> int:
    """Run every mutant; print what noticed it; return the number of unexplained survivors."""
    for tests in {mutant.tests for mutant in chosen}:
        _healthy(Mutant("no mutant", "", tests))
    waiting, runs, unexplained = list(reversed(chosen)), list[_Run](), 0
    while waiting or runs:
        while waiting and len(runs) < workers:
            runs.append(_start(waiting.pop()))
        for run, noticed in _finished(runs):
            unexplained += not noticed and not run.mutant.explanation
            verdict = f"noticed   {noticed}" if noticed else f"SURVIVES  {run.mutant.explanation or 'unexplained'}"
            print(f"{run.mutant.name:75} {verdict}", flush=True)
    print(f"{len(chosen)} mutants, {unexplained} unexplained survivors")
    return unexplained


def counts(names: Sequence[str]) -> dict[str, int]:
    """Count mutants by what they change."""
    kinds = [next(kind for kind, mark in KINDS.items() if mark in name) for name in names]
    return {kind: kinds.count(kind) for kind in KINDS}


def page(text: str, results: Sequence[str]) -> str:
    """Give the page with the table between its `mutants` markers made from what a run printed.

    A run of some kinds alone (`--only " Emcy."`) renews their rows; the others stay as they were run last.
    """
    rows = [told for line in results if (told := re.match(r"(.*?) +(noticed|SURVIVES) +(.*)", line))]
    lived = [told for told in rows if told[2] == "SURVIVES"]
    made, left = (counts([told[1] for told in some]) for some in (rows, lived))
    before, _, rest = text.partition("<!-- mutants -->")
    table = re.findall(r"^\| (.+?) \| (\d+) \| (\d+) \| (\d+) \|$", rest, re.MULTILINE)
    was = {row[0]: (int(row[1]), int(row[3])) for row in table}
    shown = {kind: (made[kind], left[kind]) if made[kind] else was.get(kind, (0, 0)) for kind in KINDS}
    shown["all"] = (sum(number for number, _ in shown.values()), sum(number for _, number in shown.values()))
    lines = ["| changed: each | mutants | noticed | not noticed |", "|---|---|---|---|"]
    lines += [f"| {kind} | {number} | {number - missed} | {missed} |" for kind, (number, missed) in shown.items()]
    lines += [""] * bool(lived) + [f"- `{told[1]}`: {told[3]}" for told in lived]
    return "\n".join([f"{before}<!-- mutants -->", *lines, rest[rest.index("<!-- end -->"):]])


def main() -> int:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="mutants whose name contains this")
    parser.add_argument("--list", action="store_true", help="name them, run nothing")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--results", type=Path, help="what a run printed; run nothing")
    parser.add_argument("--page", type=Path, help="with --results: the page that holds the table")
    given = parser.parse_args()
    if given.results and given.page:
        told = given.results.read_text(encoding="utf-8").splitlines()
        given.page.write_text(page(given.page.read_text(encoding="utf-8"), told), encoding="utf-8")
        return 0
    chosen = [mutant for mutant in mutants() if given.only in mutant.name]
    if given.list:
        print("\n".join(mutant.name for mutant in chosen))
        return 0
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    return 1 if check(chosen, given.workers) else 0


if __name__ == "__main__":
    sys.exit(main())
