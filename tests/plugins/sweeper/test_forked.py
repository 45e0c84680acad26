"""Commands as forks of one process: each is as if it had been started anew."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hydra_plugins.ahnn_sweeper import _forked

PROGRAM = """
import atexit, json, os, signal, sys
atexit.register(print, "goodbye")
defaults = [signal.getsignal(number) is signal.SIG_DFL for number in (signal.SIGTERM, signal.SIGHUP)]
facts = [__name__, sys.argv[1:], os.getppid(), all(defaults), "wave" in sys.modules, sys.stdin.read()]
print(json.dumps(facts))
os.kill(os.getppid(), signal.SIGTERM)  # as a scheduler does to everybody
{last}
"""


@pytest.fixture
def run(tmp_path: Path):
    """Run a program that ends with some line, and return its exit code and what it wrote."""

    def command(last: str, *arguments: str) -> tuple[int, str]:
        script, log = tmp_path / "program.py", tmp_path / "console.log"
        script.write_text(PROGRAM.format(last=last))
        _forked.serve(["wave", "no_such_module"])
        return _forked.exit_code(_forked.start(str(script), [*arguments], log)), log.read_text()

    return command


def test_a_command_is_as_if_it_had_been_started_anew_and_its_server_outlives_a_sigterm(run):
    parents = set()
    asked = "import signal as s; print(all(s.getsignal(n) is s.SIG_DFL for n in (s.SIGTERM, s.SIGHUP)))"
    plain = subprocess.check_output([sys.executable, "-c", asked], text=True) == "True\n"  # not under nohup
    for last, code in (("", 0), ("sys.exit(5)", 5), ("raise RuntimeError('made to fail')", 1)):
        ended, text = run(last, "seed=7", "a b")
        first, *rest = text.splitlines()
        name, arguments, parent, as_new, imported, read = json.loads(first)
        assert (ended, name, arguments, as_new, imported, read) == (
            code,
            "__main__",
            ["seed=7", "a b"],
            plain,
            True,
            "",
        )
        assert "goodbye" in rest
        assert ("\nRuntimeError: made to fail\n" in text) == (code == 1)
        assert "ForkServerProcess" not in text
        parents.add(parent)
    assert len(parents) == 1
    assert parents != {os.getpid()}


def test_a_killed_command_says_by_which_signal(run):
    assert run("os.kill(os.getpid(), signal.SIGKILL)")[0] == -9


def test_a_module_runs_as_a_command(tmp_path: Path):
    given, made, log = tmp_path / "given.json", tmp_path / "made.json", tmp_path / "console.log"
    given.write_text('{"a": 1}')
    assert _forked.exit_code(_forked.start("json.tool", [str(given), str(made)], log)) == 0
    assert json.loads(made.read_text()) == {"a": 1}
