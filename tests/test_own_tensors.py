"""The same numbers in a file and in tensors: one training, one verdict, one table."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch
from entry import call, untouched
from test_own_data import SD, swings
from test_own_data import SMALL as FILES

import ahnn

SMALL = [text for text in FILES if not text.startswith("system=")]
SPACE = ahnn.Space("files", ("q", "pq"), ahnn.Units("s", "m", "m/s", "m²/s²"))
RECORDED = ["model=ahnn", "hamiltonian=mechanical", "sensor=recorded", "loss.stages=[[16, 1.0]]"]
CASES = {
    "states with a noise of each component": (4, SD, [f"data.noise=[{SD},{2 * SD}]", *RECORDED]),
    "positions": (3, SD, [f"data.noise={SD}", *RECORDED]),
    "exact states": (4, 0.0, ["model=hnn", "model.network.width=8", "loss.derivative=0", "window=2"]),
}


def tensors(path: Path) -> ahnn.Trajectories:
    """What stands in a table with an id, padded with NaN, read by Python alone."""
    rows: dict[str, list[list[float]]] = {}
    for name, *cells in list(csv.reader(path.read_text().splitlines()))[1:]:
        rows.setdefault(name, []).append([float(cell or "nan") for cell in cells])
    tracks = [torch.tensor(row, dtype=torch.float64) for row in rows.values()]
    padded = torch.nn.utils.rnn.pad_sequence(tracks, batch_first=True, padding_value=torch.nan)
    return ahnn.Trajectories(padded[..., 1:], padded[..., 0])


@pytest.mark.parametrize("case", CASES)
def test_the_same_numbers_make_the_same_run(tmp_path, case):
    """Irregular times, gaps, a missing number, trajectories of two lengths; masses are 1."""
    columns, noise, asked = CASES[case]
    data = swings(tmp_path / "swings.csv", columns, noise, whole=False)
    lines = data.read_text().splitlines()
    lines[7] = ",".join([*lines[7].split(",")[:-1], ""])
    data.write_text("\n".join(lines) + "\n")
    options = [*SMALL, *asked, "trainer.max_epochs=2", "threads=1"]
    assert (
        call("ahnn.train", "system=files", f"system.path={data}", *options, f"run={tmp_path / 'file'}") == 0
    )
    with untouched():
        ahnn.fit(tensors(data), SPACE, options, folder=tmp_path / "tensors")
    one, other = (ahnn.load(tmp_path / name) for name in ("file", "tensors"))
    for mine, theirs in zip(
        one.dynamics.state_dict().values(), other.dynamics.state_dict().values(), strict=True
    ):
        assert torch.equal(mine, theirs)
    assert (one.dt, one.space) == (other.dt, other.space)
    a, b = one.results, other.results
    assert repr(a.rows) == repr(b.rows)  # NaN is what is not known
    assert repr(a.numbers) == repr(b.numbers)
    assert (a.label, a.assumes) == (b.label, b.assumes)
    if noise:
        assert [row.who.start for row in a.rows] == ["fitted"]
        one, other = (tmp_path / name / "covariance.safetensors" for name in ("file", "tensors"))
        assert one.read_bytes() == other.read_bytes()
