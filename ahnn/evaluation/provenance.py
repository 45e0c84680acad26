"""Provenance of an evaluation: versions, command, machine, date."""

from __future__ import annotations

import platform
import re
import shlex
import subprocess
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import torch

PASSWORD = re.compile(r"://[^@/\s]*@")
"""Pattern of user and password in an address, for example of a database."""


def provenance() -> dict[str, Any]:
    """Return the provenance of results, for metrics.json; `commit` is None outside a checkout of `ahnn`."""
    import ahnn  # the package may be partially imported when this module is loaded

    lightning = sys.modules.get("lightning")
    return {
        "ahnn": ahnn.__version__,
        "commit": commit(Path(__file__).parents[2]),
        "command": PASSWORD.sub("://***@", shlex.join(sys.orig_argv)),
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "host": platform.node(),
        "threads": torch.get_num_threads(),
        "python": platform.python_version(),
        "torch": str(torch.__version__),
        "lightning": getattr(lightning, "__version__", None),
    }


def commit(root: Path) -> str | None:
    """Return the commit of a checkout, with `-dirty` for modified files; None for other folders."""
    if not (root / ".git").exists():
        return None
    # `git describe --dirty` locks the index and would leave the lock behind if killed with this process.
    status = ["git", "-C", str(root), "--no-optional-locks", "status", "--porcelain=v2", "--branch", "-uno"]
    try:
        done = subprocess.run(status, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    lines = done.stdout.splitlines()
    heads = [line.removeprefix("# branch.oid ") for line in lines if line.startswith("# branch.oid ")]
    return "".join(heads) + "-dirty" * any(not line.startswith("#") for line in lines) or None
