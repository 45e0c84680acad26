"""Run folders of somebody else's: what they say acts, nothing in them is run, and they say not where is written."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import yaml

from ahnn.checkpoints import read_weights
from ahnn.errors import UserError

from .children import plain, trained
from .doors import NOISE, START, answered, enter, fixes, numbers
from .fields_runs import SHIPPED, beside, copied


def cases(draw, folder):
    """Yield another legal value, or code in the folder and a door."""
    child = trained(folder / "run", "trainer.max_epochs=1")
    assert child.code() == 0, child.said()
    while True:
        place = Path(tempfile.mkdtemp(dir=folder))
        if draw.random() < 0.5:
            name = draw.choice(list(LEGAL))
            yield f"another {name}", partial(LEGAL[name], place)
        else:
            name, door = draw.choice(PLANTED), draw.choice(DOORS)
            yield f"{name} in the folder, {door}", partial(planted, place, name, door)


def predicted(place: Path, change, *more: str) -> list[list[str]]:
    """Return the cells of a prediction with something else beside the weights."""
    run, known = copied(place), read_weights(SHIPPED / "weights.safetensors").about
    change(known)
    beside(run, known)
    words = [f"run={run}", f"start={numbers(START)}", "duration=10min", f"output={place}/o.csv", *more]
    answered(*enter(place, "predict", *words))
    return [line.split(",") for line in (place / "o.csv").read_text().splitlines()]


def another_step(place: Path) -> None:
    """The step between predictions is that of the training."""
    rows = predicted(place, lambda known: known.update(dt=30.0))
    assert float(rows[2][1]) == 30.0, rows[2][:2]


def another_mass(place: Path) -> None:
    """Velocities are momenta over the mass."""

    def change(known: dict) -> None:
        known["space"]["inertia"] = known["dynamics"]["inertia"] = 2.0

    rows = predicted(place, change)
    column = rows[0].index("vx [km/s]")
    assert float(rows[1][column]) == 5.0, rows[1]


def another_name(place: Path) -> None:
    """Columns have the names and units of the space."""

    def change(known: dict) -> None:
        known["space"]["components"] = ["a", "b", "c", "pa", "pb", "pc"]
        known["space"]["units"] = ["min", "m", "m/min", "J"]

    assert predicted(place, change, "duration=10min")[0][1:4] == ["t [min]", "a [m]", "b [m]"]


def another_cache(place: Path) -> None:
    """A folder says not where is written."""
    run = shutil.copytree(place.parent / "run", place / "run")
    config = yaml.safe_load((run / "config.yaml").read_text())
    config["data"] |= {"cache": str(place / "elsewhere"), "seed": 5}
    (run / "config.yaml").unlink()
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    code, said = enter(place, "evaluate", f"run={run}", "name=x", "plugins=none")
    assert not (place / "elsewhere").exists(), "written where a foreign folder said"
    answered(code, said)


LEGAL = {"step": another_step, "mass": another_mass, "name": another_name, "cache": another_cache}
DOORS = ["evaluate", "report", "predict", "assimilate", "train"]
PLANTED = ["hydra_plugins/x.py", "hydra_plugins/__init__.py", "ahnn_plugins/__init__.py", "sitecustomize.py",
           "ahnn_plugins/x.py", "numpy.py", "yaml.py"]  # fmt: skip
"""Not `ahnn`: Python itself takes the package named after `-m` from the working directory, before any code of ours."""


def planted(place, name, door) -> None:
    """Work in a folder that has code of the names of ours; none of it is run."""
    run = shutil.copytree(place.parent / "run", place / "run")
    (run / name).parent.mkdir(exist_ok=True)
    (run / name).write_text(f"open({str(place / 'executed')!r}, 'w').close()\n")
    words = {
        "evaluate": ["run=.", "name=x", "plugins=none"],
        "report": ["run=.", "report.figures=false"],
        "predict": ["run=.", "start=[0.1,0]", "duration=1s"],
        "assimilate": ["run=.", f"measurements={fixes(place / 'f.csv', [(0.1, 0.1)], 'time,q')}", "start=[0.1,0.0]",
                       "start_sd=[1,1]", "measurement.sd=0.1", NOISE, f"output={place}/o.csv"],
        "train": ["run=.", "trainer.max_epochs=1", "ckpt=last"],
    }  # fmt: skip

    line = [sys.executable, "-m", f"ahnn.{door}", *words[door]]
    done = subprocess.run(line, cwd=run, capture_output=True, text=True, errors="replace", timeout=240)
    code, said = done.returncode, done.stdout + done.stderr
    assert not (place / "executed").exists(), f"executed {name}"
    plain(said)
    if code:
        raise UserError(said)
