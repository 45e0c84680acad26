"""Environments: variables, folders and streams that are odd; the command works or refuses in a sentence."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from ahnn.errors import UserError

from .children import TRAINING, plain

VARIABLES = {
    "SLURM_NTASKS": ["4", "1", "x", ""],
    "SLURM_JOB_ID": ["7", ""],
    "SLURM_JOB_NAME": ["bash", "mine"],
    "SLURM_PROCID": ["0", "1", "x"],
    "WORLD_SIZE": ["2", "1", "x"],
    "RANK": ["0", "x"],
    "LOCAL_RANK": ["0", "1"],
    "MASTER_ADDR": ["localhost", "?"],
    "OMP_NUM_THREADS": ["0", "x", "-1", "100000"],
    "CUDA_VISIBLE_DEVICES": ["", "9", "x"],
    "LANG": ["C", "xx_YY.UTF-8", ""],
    "LC_ALL": ["C", "POSIX", "tr_TR.UTF-8"],
    "PYTHONIOENCODING": ["ascii", "latin-1", "utf-16"],
    "PYTHONUTF8": ["0", "1"],
    "TERM": ["dumb", "", "xterm-256color"],
    "COLUMNS": ["1", "0", "x", "100000"],
    "FORCE_COLOR": ["1"],
    "NO_COLOR": ["1"],
    "HOME": ["/nonexistent", "", "/dev/null"],
    "TMPDIR": ["/nonexistent", "/dev/null"],
    "AHNN_CACHE": ["/dev/null", "/dev/null/x", "", "relative", "~/x", "/proc/x", "a=b", "ü ²", "${x}"],
    "HYDRA_FULL_ERROR": ["0", "1"],
    "PYTHONWARNINGS": ["always", "ignore"],
    "PYTHONOPTIMIZE": ["1", "2"],
    "PYTHONDONTWRITEBYTECODE": ["1"],
    "PYTHONHASHSEED": ["0", "7"],
    "MPLBACKEND": ["nonsense", "TkAgg"],
    "MPLCONFIGDIR": ["/dev/null/x"],
    "XDG_CACHE_HOME": ["/dev/null/x"],
    "TORCH_LOGS": ["", "+all"],
    "TZ": ["Pacific/Kiritimati", "x"],
}
PLACES = ["a b", "a=b", "ü²", "it's", "[x]", "${x}", "-x", "a,b", "#", "plain"]
STREAMS = ["", "", "", "</dev/null", "<&-", ">&-", "2>&-", ">/dev/full", "| head -c 1", "2>&1 | cat"]


def cases(draw, folder):
    """Yield environments with one to three oddities."""
    while True:
        names = draw.sample(list(VARIABLES), draw.randint(0, 3))
        env = {name: draw.choice(VARIABLES[name]) for name in names}
        place, stream = draw.choice(PLACES), draw.choice(STREAMS)
        umask, gone = draw.choice(["022", "077", "000", "777"]), draw.random() < 0.05
        yield (
            f"{env} in {place!r} {stream} umask {umask}{' gone' * gone}",
            partial(attempt, folder, env, place, stream, umask, gone),
        )


def attempt(folder, env, place, stream, umask, gone) -> None:
    """Train in a process of its own, through a shell."""
    base = Path(tempfile.mkdtemp(dir=folder))
    home = base / place
    home.mkdir()
    known = {k: v for k, v in os.environ.items() if not k.startswith(("AHNN", "OMP"))}
    known |= {"PYTHONPATH": os.pathsep.join(sys.path), "AHNN_CACHE": str(base / "cache")} | env
    words = [w for w in TRAINING if "epochs" not in w]
    line = f'{"rmdir ../*; " * gone}umask {umask}; exec "$0" -m ahnn.train "$@" trainer.max_epochs=1 {stream}'
    line = line.replace("exec ", "") if "|" in stream else line
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {line}", sys.executable, *words],
        cwd=home, env=known, capture_output=True, text=True, errors="replace", timeout=180, check=False,
    )  # fmt: skip
    said = done.stdout + done.stderr
    plain(said)
    gone_reader = done.returncode == 128 + signal.SIGPIPE and "head" in stream
    assert done.returncode in (0, 2) or gone_reader, f"exit code {done.returncode}: {said[-300:]}"
    subprocess.run(["chmod", "-R", "u+rwX", str(base)], check=False)
    if done.returncode == 2:
        assert "ahnn: " in said or "2>&-" in stream, said[-300:]
    shutil.rmtree(base, ignore_errors=True)
    if done.returncode == 2:
        raise UserError(said or "refused without a stream to say it")
