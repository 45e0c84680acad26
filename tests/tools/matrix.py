"""Run the default suite on each Python of this machine with the newest libraries, and once with the oldest.

`python tests/tools/matrix.py [PYTEST ARGUMENT ...]`, by default all of `tests`. uv makes the environments in
build/matrix, several GB for each torch; the table is build/matrix/table.md.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PLACE = ROOT / "build" / "matrix"
VERSIONS = ("3.11", "3.12", "3.13", "3.14")
PRINT = "import torch, numpy; print(torch.__version__, numpy.__version__)"


def pythons() -> dict[str, str]:
    """Return the interpreters on the path and under pyenv, by version."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = {}
    for version in VERSIONS:
        candidates = [*sorted(pyenv.glob(f"{version}.*/bin/python")), shutil.which(f"python{version}")]
        for candidate in filter(None, candidates):
            if subprocess.run([candidate, "-V"], capture_output=True, check=False).returncode == 0:
                found.setdefault(version, str(candidate))
    return found


def row(version: str, python: str, resolution: str, arguments: list[str]) -> str:
    """Make an environment, run the tests, and return a line of the table."""
    place = PLACE / f"{version}-{resolution}"
    ours = place / "bin" / "python"
    uv = [sys.executable, "-m", "uv"]
    subprocess.run([*uv, "venv", "-q", "--seed", "--clear", "-p", python, place], check=True)
    install = [*uv, "pip", "install", "-q", "-p", ours, f"--resolution={resolution}", "-e", f"{ROOT}[dev]"]
    subprocess.run(install, check=True)
    # the newest indirect libraries warn of what the oldest direct ones still do
    lenient = ["-o", "filterwarnings=default"] if resolution == "lowest-direct" else []
    command = [ours, "-m", "pytest", "-n", "2", "--dist", "loadfile", *lenient, *arguments]
    with (place / "pytest.log").open("w+") as log:
        subprocess.run(command, cwd=ROOT, stdout=log, stderr=log, check=False)
        log.seek(0)
        counts = re.findall(r"(\d+) (passed|failed|errors?)\b", log.read())
    number = {kind.rstrip("s"): int(count) for count, kind in counts}
    torch, numpy = subprocess.check_output([ours, "-c", PRINT], text=True).split()
    failed = number.get("failed", 0) + number.get("error", 0)
    return f"| {version} | {resolution} | {torch} | {numpy} | {number.get('passed', 0)} | {failed} |"


def main() -> None:
    """Run every combination, and print and write the table."""
    found = pythons()
    runs = [(version, path, "highest") for version, path in found.items()]
    runs += [(version, path, "lowest-direct") for version, path in list(found.items())[:1]]
    head = ["| Python | libraries | torch | numpy | passed | failed |", "|---|---|---|---|---|---|"]
    PLACE.mkdir(parents=True, exist_ok=True)
    rows = []
    for run in runs:
        rows.append(row(*run, sys.argv[1:] or ["tests"]))
        (PLACE / "table.md").write_text("\n".join([*head, *rows]) + "\n")
    sys.stdout.write((PLACE / "table.md").read_text())
    sys.exit(any(not line.endswith(" 0 |") for line in rows))


if __name__ == "__main__":
    main()
