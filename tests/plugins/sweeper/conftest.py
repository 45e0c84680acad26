"""Make the helpers importable, and start a PostgreSQL server where Debian's packages are installed."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

_PACKAGES = Path("/usr/lib/postgresql")


@pytest.fixture(scope="session")
def postgres() -> Iterator[str]:
    """URL of an empty database of a server that lives as long as the tests."""
    pytest.importorskip("psycopg", reason="the extra postgres is not installed")
    binaries = sorted(path.parent for path in _PACKAGES.glob("*/bin/pg_ctl"))
    if not binaries:
        pytest.skip(f"no PostgreSQL server below {_PACKAGES}; apt-get install postgresql")
    folder = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))  # a socket's path is short
    user = "postgres" if os.geteuid() == 0 else None  # the server refuses to run as root
    if user:
        shutil.chown(folder, user)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    data, options = folder / "data", f"-k {folder} -p {port} -h 127.0.0.1 -F"

    def call(*command: str) -> None:
        subprocess.run([*command], check=True, user=user, cwd=folder, stdout=subprocess.DEVNULL)

    call(str(binaries[-1] / "initdb"), "-D", str(data), "-U", "ahnn", "-A", "trust", "--no-sync")
    control = [str(binaries[-1] / "pg_ctl"), "-D", str(data), "-l", str(folder / "log"), "-w"]
    call(*control, "-o", options, "start")
    try:
        yield f"postgresql+psycopg://ahnn@127.0.0.1:{port}/postgres"
    finally:
        call(*control, "-m", "immediate", "stop")
        shutil.rmtree(folder, ignore_errors=True)
