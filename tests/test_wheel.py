"""A wheel carries its configuration and plugins, and runs from any directory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def run(*command, **options):
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | options.pop("env", {})
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        **options,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


TYPED = """
import ahnn

run = ahnn.load("molniya_mechanical")
reveal_type(run)
reveal_type(run.rollout([1.0, 0.0], steps=3))
reveal_type(ahnn.Trajectories)
ahnn.load(3)
"""


def require_types(python, place):
    """Assert that mypy takes types from the wheel: what calls return, and which arguments they refuse."""
    (place / "typed.py").write_text(TYPED)
    command = [sys.executable, "-m", "mypy", "--python-executable", str(python), "--follow-imports=silent"]
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "MYPYPATH")}
    done = subprocess.run(
        [*command, "typed.py"], cwd=place, env=environment, capture_output=True, text=True, check=False
    )
    assert 'Revealed type is "ahnn.runs.Run"' in done.stdout, done.stdout + done.stderr
    assert "torch._tensor.Tensor" in done.stdout
    assert done.stdout.count("error:") == 1, done.stdout
    assert 'incompatible type "int"' in done.stdout


@pytest.mark.slow
def test_a_wheel_in_a_fresh_environment_trains_from_any_directory(tmp_path):
    pip = (sys.executable, "-m", "pip")
    pytest.importorskip("hatchling", reason="the wheel is built without network")
    run(*pip, "wheel", ROOT, "--no-deps", "--no-build-isolation", "-q", "-w", tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {"ahnn/conf/train.yaml", "ahnn/py.typed"} <= {*names}
    assert {str(path.relative_to(ROOT)) for path in (ROOT / "ahnn").rglob("*.[ch]")} <= {*names}
    shipped = {"paper.csv", "suspicious.csv", "page.css"}  # what a report reads
    assert {f"ahnn_plugins/report/{name}" for name in shipped} <= {*names}
    assert {n.split("/")[0] for n in names if "dist-info" not in n} == {
        "ahnn",
        "ahnn_plugins",
        "hydra_plugins",
    }
    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv")
    python = tmp_path / "venv" / "bin" / "python"
    (site,) = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    parent = next(p for p in sys.path if p.endswith("site-packages"))
    (site / "dependencies.pth").write_text(parent)  # --system-site-packages would skip our own environment
    zipfile.ZipFile(wheel).extractall(site)
    place = tmp_path / "elsewhere"
    place.mkdir()
    require_types(python, place)
    where = run(python, "-c", "import ahnn.paths; print(ahnn.paths.conf_dir())", cwd=place).strip()
    assert where == str(site / "ahnn" / "conf")
    assert "[laptop]" in run(python, "-m", "ahnn.train", "--help", cwd=place)
    cache = {"AHNN_CACHE": str(tmp_path / "cache")}
    run(python, "-m", "ahnn.train", "budget=smoke", "run=out", "trainer.max_epochs=1", cwd=place, env=cache)
    assert json.loads((place / "out" / "metrics.json").read_text())["model"] == "ahnn5"
