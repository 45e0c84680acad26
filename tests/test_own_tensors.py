"""The same numbers in a file and in tensors: one training, one verdict, one table."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch
from entry import call, untouched
from omegaconf import OmegaConf
from safetensors.torch import load_file
from test_own_data import SD, swings
from test_own_data import SMALL as FILES

import ahnn
from ahnn.cli.compose import compose_job, composed, with_recorded
from ahnn.cli.prepare import prepare
from ahnn.data import SPLITS, Given
from ahnn.data.recorded_sensor import Recorded

SMALL = [
    *(text for text in FILES if not text.startswith("system=")),
    *("trainer.max_epochs=1", "data.split=[0.34,0.33,0.33]", "model.network.width=4"),
]
SPACE = ahnn.Space("files", ("q", "pq"), ahnn.Units("s", "m", "m/s", "m²/s²"))
RECORDED = ["model=ahnn", "hamiltonian=mechanical", "sensor=recorded", "loss.stages=[[16, 1.0]]"]
CASES = {
    "states": (4, SD, [f"data.noise={SD}", *RECORDED]),
    "states with a noise of each component": (4, SD, [f"data.noise=[{SD},{2 * SD}]", *RECORDED]),
    "states of which positions are taken": (4, SD, [f"data.noise={SD}", "data.measured=position", *RECORDED]),
    "positions": (3, SD, [f"data.noise={SD}", *RECORDED]),
    "positions in pieces": (3, SD, [f"data.noise={SD}", "system.cut=20", "system.gap=3", *RECORDED]),
    "exact states": (4, 0.0, ["model=hnn", "loss.derivative=0", "window=2"]),
}


def table(path: Path, columns: int, noise: float) -> Path:
    """Three trajectories at irregular times with gaps, one of them shorter, and a missing number."""
    lines = swings(path, columns, noise, whole=False).read_text().splitlines()
    lines = [line for line in lines if line.split(",")[0] in ("id", "0", "1", "2")]
    lines[7] = ",".join([*lines[7].split(",")[:-1], ""])
    path.write_text("\n".join(lines) + "\n")
    return path


def tensors(path: Path) -> ahnn.Trajectories:
    """What stands in a table with an id, padded with NaN, read by Python alone."""
    rows: dict[str, list[list[float]]] = {}
    for name, *cells in list(csv.reader(path.read_text().splitlines()))[1:]:
        rows.setdefault(name, []).append([float(cell or "nan") for cell in cells])
    tracks = [torch.tensor(row, dtype=torch.float64) for row in rows.values()]
    padded = torch.nn.utils.rnn.pad_sequence(tracks, batch_first=True, padding_value=torch.nan)
    return ahnn.Trajectories(padded[..., 1:], padded[..., 0])


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("padded", [False, True])
@pytest.mark.sampled(5)
def test_training_sees_the_same(tmp_path, case, padded):
    columns, noise, asked = CASES[case]
    data = table(tmp_path / "swings.csv", columns, noise)
    given = tensors(data)
    if columns == 3 and padded:
        given = given._replace(states=torch.nn.functional.pad(given.states, (0, 1), value=torch.nan))
    options = ["system=files", *SMALL, *asked]
    with untouched():
        one = prepare(compose_job([*options, f"system.path={data}"], tmp_path / "one")).data
        cfg = compose_job(options, tmp_path / "other")
        keys = {key: cfg.system[key] for key in ("cut", "gap")}
        other = prepare(cfg, Given(given, SPACE, **keys)).data
    assert type(one.sensor) is type(other.sensor) is (Recorded if noise else type(None))
    assert one.source.space == other.source.space
    for split in SPLITS:
        pairs = zip(one.trajectories(split)[:2], other.trajectories(split)[:2], strict=True)
        for mine, theirs in pairs:
            assert torch.equal(mine.nan_to_num(7.0), theirs.nan_to_num(7.0))
    for mine, theirs in zip(one.statistics(), other.statistics(), strict=True):
        assert mine is theirs or torch.equal(torch.as_tensor(mine), torch.as_tensor(theirs))
    assert one.remark() == other.remark()


@pytest.mark.parametrize(
    ("asked", "sensor", "recipe"),
    [
        ([], "none", "second_order"),
        (["data.noise=0.01"], "recorded", "measurements"),
        (["data.noise=estimate"], "recorded", "measurements"),
        (["data.noise=0.01", "recipe=noisy_states"], "none", "noisy_states"),
    ],
)
def test_noise_of_numbers_from_outside_makes_them_measurements_unless_a_recipe_is_named(
    asked, sensor, recipe
):
    texts = with_recorded(["train.py", "system=files", *asked, "hamiltonian=mechanical", "-m"])
    assert [text for text in texts if text.startswith("sensor=")] == ["sensor=recorded"] * (
        sensor == "recorded"
    )
    assert texts[-1] == "-m"
    found = composed("train", ["system=files", *asked, "hamiltonian=mechanical"])
    named = composed(
        "train", ["system=files", *asked, "hamiltonian=mechanical", f"sensor={sensor}", f"recipe={recipe}"]
    )
    assert OmegaConf.to_container(found) == OmegaConf.to_container(named)


def test_columns_that_are_missing_are_named_as_positions(tmp_path):
    """Whoever forgets the velocities must not look for the mistake in the noise."""
    data = ahnn.Trajectories(torch.rand(30, 50, 2, dtype=torch.float64), 0.1 * torch.arange(50.0))
    space = ahnn.Space("plane", ("x", "y", "vx", "vy"))
    with pytest.raises(ahnn.UserError, match=r"\(2 columns read as x, y of a space with 4 components\)"):
        ahnn.fit(data, space, ["model=hnn"], folder=tmp_path / "run")


@pytest.mark.slow
def test_the_same_numbers_make_the_same_run(tmp_path):
    columns, noise, asked = CASES["states with a noise of each component"]
    data = table(tmp_path / "swings.csv", columns, noise)
    options = [*SMALL, *asked, "loss.closing=1", "evaluation.figures=false"]
    folders = tmp_path / "file", tmp_path / "tensors"
    assert call("ahnn.train", "system=files", f"system.path={data}", *options, f"run={folders[0]}") == 0
    with untouched():
        ahnn.fit(tensors(data), SPACE, options, folder=folders[1])
    one, other = map(ahnn.load, folders)
    weights = (run.dynamics.state_dict().values() for run in (one, other))
    assert all(torch.equal(*pair) for pair in zip(*weights, strict=True))
    assert (one.dt, one.space) == (other.dt, other.space)
    assert [row.who.start for row in other.results.rows] == ["fitted"]
    assert repr(one.results.rows) == repr(other.results.rows)  # NaN is what is not known
    assert repr(one.results.numbers) == repr(other.results.numbers)
    mine, theirs = (load_file(folder / "covariance.safetensors") for folder in folders)
    assert mine.keys() == theirs.keys()
    assert all(torch.equal(mine[name], theirs[name]) for name in mine)
