"""Which tests reach a line, and whether they notice a change of it.

The tests run once under coverage, each in a context of its own. A mutant is then judged by the tests that
execute its line, the quick ones first, in a fork of a process that has imported everything but the tree.
"""

from __future__ import annotations

import ast
import importlib
import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import coverage
import pytest

HEAVY = ("torch", "lightning", "hydra", "scipy.stats", "hypothesis", "optuna", "matplotlib.pyplot", "rich")
"""What is imported once; no mutant changes it."""

QUIET = ("-q", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning")
LIMIT_TESTS, LIMIT_SECONDS, SLOW = 400, 30.0, 1.0
"""Most tests of one mutant, about how long they take, and what comes last, in seconds."""
TOGETHER = 25
"""Test files measured at once; what was measured is kept if a later part fails."""


class Recorder:
    """A pytest plugin: a coverage context and a duration for every test."""

    def __init__(self, traced: coverage.Coverage) -> None:
        self.traced = traced
        self.seconds: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item):
        self.traced.switch_context(item.nodeid)
        begin = time.monotonic()
        try:
            return (yield)
        finally:
            self.seconds[item.nodeid] = time.monotonic() - begin
            self.traced.switch_context("")


class Chosen:
    """A pytest plugin: only these tests, in this order."""

    def __init__(self, names: list[str]) -> None:
        self.rank = {name: i for i, name in enumerate(names)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((i for i in items if i.nodeid in self.rank), key=lambda i: self.rank[i.nodeid])


class Reach:
    """Which tests execute which lines of a tree, kept in a file.

    Args:
        tree: copy of the repository that the tests run in.
        store: where the measurement is kept between sessions.
    """

    def __init__(self, tree: Path, store: Path) -> None:
        self.tree, self.store = tree, store
        self.lines: dict[str, dict[str, list[int]]] = {}
        self.seconds: dict[str, float] = {}
        self.stamps: dict[str, str] = {}
        if store.exists():
            self.lines, self.seconds, self.stamps = json.loads(store.read_text())

    def measure(self, folders: Iterable[str]) -> None:
        """Run the test files that have changed, or reach what has changed, since they were last measured."""
        files = sorted({f for folder in folders for f in _test_files(self.tree, folder)})
        current = self.current(files)
        stale = [f for f in files if self.stamps.get(f) != current[f]]
        if not stale:
            return
        result = self.store.with_suffix(".part")
        for part in (stale[k : k + TOGETHER] for k in range(0, len(stale), TOGETHER)):
            result.unlink(missing_ok=True)
            forked(lambda part=part: _measured(self.tree, part, result), self.tree, 3000)
            lines, seconds = json.loads(result.read_text())
            self.seconds = {t: s for t, s in self.seconds.items() if t.split("::")[0] not in part} | seconds
            self.lines = {t: x for t, x in self.lines.items() if t.split("::")[0] not in part} | lines
            self.stamps |= self.current(part)
            self.store.write_text(json.dumps([self.lines, self.seconds, self.stamps]))

    def current(self, files: list[str]) -> dict[str, str]:
        """Return a stamp of each test file, of its text and of the files that its tests reach."""
        reached: dict[str, set[str]] = {f: {f} for f in files}
        for name, sources in self.lines.items():
            reached.get(name.split("::")[0], set()).update(sources)
        known = {p: self.tree / p for paths in reached.values() for p in paths}
        hashes = {p: hash_of(path) for p, path in known.items() if path.exists()}
        return {f: str([hashes.get(p) for p in sorted(paths)]) for f, paths in reached.items()}

    def tests(self, file: str, first: int, last: int, near: str) -> list[str]:
        """Return some tests that execute a line of a file; where only its import does, any line of it.

        Of a file of constants, those below the folder `near`. Tests in files named like the file come first,
        then those in that folder.
        """
        reaching = [t for t, files in self.lines.items() if file in files]
        exact = [t for t in reaching if any(first <= n <= last for n in self.lines[t][file])]
        if executed_at_import((self.tree / file).read_text(), first):  # by whichever test came first
            exact = reaching
        chosen = exact or reaching or [t for t in self.seconds if t.startswith(near)]
        seen: dict[str, int] = {}
        order = []
        for seconds, name in sorted((self.seconds.get(t, 0.0), t) for t in chosen):
            function = name.split("[")[0]
            seen[function] = seen.get(function, -1) + 1
            few = min(seen[function], 3)  # three cases of each first, and those of the room
            own = Path(file).stem.strip("_") in Path(name.split("::")[0]).stem
            order.append((seconds > SLOW, not own, few, not name.startswith(near), seconds, name))
        names, left = [], LIMIT_SECONDS
        for *_, seconds, name in sorted(order)[:LIMIT_TESTS]:
            if seconds <= left or not names:
                names.append(name)
                left -= seconds
        return names


def executed_at_import(source: str, line: int) -> bool:
    """Return whether a line is in the body of no function."""
    functions = [f for f in ast.walk(ast.parse(source)) if isinstance(f, ast.FunctionDef)]
    return not any(f.body[0].lineno <= line <= (f.end_lineno or 0) for f in functions)


def hash_of(path: Path) -> int:
    """Return a number that changes with the text of a file and not with the process."""
    return sum((i % 9973 + 1) * byte for i, byte in enumerate(path.read_bytes()))


def noticed(tree: Path, names: list[str], timeout: float) -> bool:
    """Return whether one of the tests fails, or the time is up."""
    files = sorted({name.split("::")[0] for name in names})
    return forked(lambda: _run(["-x", *files], [Chosen(names)]), tree, timeout) not in (0, 5)


def forked(work: Callable[[], int], tree: Path, timeout: float) -> int:
    """Return the exit code of some work in a fork that imports a tree; 124 where its time is up."""
    for name in HEAVY:
        importlib.import_module(name)
    child = os.fork()
    if child == 0:
        os.setsid()
        os.chdir(tree)
        null = os.open(os.environ.get("MUTANT_OUTPUT", os.devnull), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(null, 1)
        os.dup2(null, 2)
        sys.path[:0] = [str(tree), str(tree / "plugins")]
        os.environ["PYTHONPATH"] = f"{tree}{os.pathsep}{tree / 'plugins'}"
        code = 3
        try:
            code = work()
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
        finally:
            os._exit(code)
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return 124


def _run(arguments: list[str], plugins: list[Any]) -> int:
    return int(pytest.main([*QUIET, *arguments], plugins=plugins))


def _measured(tree: Path, files: list[str], result: Path) -> int:
    traced = coverage.Coverage(
        data_file=None, config_file=False, source=[str(tree / "ahnn"), str(tree / "plugins")]
    )
    recorder = Recorder(traced)
    traced.start()
    code = _run(files, [recorder])
    traced.stop()
    data = traced.get_data()
    lines: dict[str, dict[str, list[int]]] = {}
    for measured in data.measured_files():
        file = str(Path(measured).relative_to(tree))
        for line, contexts in data.contexts_by_lineno(measured).items():
            for context in contexts:
                if context:
                    lines.setdefault(context, {}).setdefault(file, []).append(line)
    result.write_text(json.dumps([lines, recorder.seconds]))
    return code


def _test_files(tree: Path, folder: str) -> list[str]:
    path = tree / folder
    found = [path] if path.suffix == ".py" else sorted(path.rglob("test_*.py"))
    return [str(p.relative_to(tree)) for p in found if p.exists()]
