"""Helpers of the sweeper's tests: start the toy application as a user would, and read its study."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from runpy import run_path
from tempfile import TemporaryFile
from traceback import print_exc

import optuna

ROOT = Path(__file__).parents[3]
APP = Path(__file__).with_name("toy_app.py")
SEARCH = ("hydra/sweeper=ahnn_optuna", "x=interval(0.0,1.0)")


ENVIRONMENT = {
    "PYTHONPATH": f"{ROOT / 'plugins'}{os.pathsep}{ROOT}",
    "AHNN_CONF": str(ROOT / "conf"),
    "OMP_NUM_THREADS": "1",
    "COLUMNS": "160",
}


def start(sweep_dir: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a multirun in its own process."""
    environment = os.environ | ENVIRONMENT
    command = [sys.executable, str(APP), "-m", f"hydra.sweep.dir={sweep_dir}", *arguments]
    return subprocess.Popen(
        command,
        env=environment,
        cwd=sweep_dir.parent,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )


def sweep(sweep_dir: Path, *arguments: str) -> tuple[int, str]:
    """Run a multirun to its end and return its exit code and output."""
    process = start(sweep_dir, *arguments)
    output, _ = process.communicate(timeout=300)
    return process.returncode, output


def forked_sweep(sweep_dir: Path, *arguments: str) -> tuple[int, str]:
    """Run a multirun to its end in a copy of this process, with its imports, as `sweep` does in a new one."""
    for name in ("optuna.visualization.matplotlib", "sqlalchemy.orm", "hydra_plugins.ahnn_sweeper.sweeper"):
        import_module(name)  # once, for all copies
    with TemporaryFile("w+") as said:
        process = os.fork()
        if process == 0:
            os.dup2(said.fileno(), 1)
            os.dup2(said.fileno(), 2)
            os._exit(_run(sweep_dir, *arguments))
        _, status = os.waitpid(process, 0)
        said.seek(0)
        return os.waitstatus_to_exitcode(status), said.read()


def _run(sweep_dir: Path, *arguments: str) -> int:
    os.environ |= ENVIRONMENT
    os.chdir(sweep_dir.parent)
    warnings.simplefilter("default")
    sys.argv = [str(APP), "-m", f"hydra.sweep.dir={sweep_dir}", *arguments]
    with os.fdopen(1, "w", 1, closefd=False) as out, redirect_stdout(out), redirect_stderr(out):
        try:
            run_path(str(APP), run_name="__main__")
        except SystemExit as stopped:
            return int(stopped.code or 0)
        except BaseException:
            print_exc()
            return 1
    return 0


def trials(
    sweep_dir: Path, storage: str | None = None, name: str = "sweep"
) -> list[optuna.trial.FrozenTrial]:
    """Return the trials of the study that a sweep left."""
    from hydra_plugins.ahnn_sweeper._storage import open_storage

    opened = open_storage.__wrapped__(storage or f"journal:///{sweep_dir / 'study.journal'}")
    found = optuna.load_study(study_name=name, storage=opened).trials
    if isinstance(opened, optuna.storages.RDBStorage):
        opened.remove_session()
        opened.engine.dispose()
    return found


def states(found: list[optuna.trial.FrozenTrial]) -> list[str]:
    """Return the names of the states, by number."""
    return [trial.state.name for trial in found]


def assert_none_lost_or_doubled(found: list[optuna.trial.FrozenTrial], total: int) -> None:
    """Assert that `total` trials are finished, and that only a retry repeats the parameters of another."""
    from hydra_plugins.ahnn_sweeper._ledger import count, replaced

    counts = count(found)
    assert counts.finished == total
    assert counts.running == counts.waiting == 0
    assert [trial.number for trial in found] == list(range(total + counts.replaced))
    kept = [tuple(trial.params.values()) for trial in found if trial.number not in replaced(found)]
    assert len(set(kept)) == len(kept)
