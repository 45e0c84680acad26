"""The examples of docs/filter.md run, and show what the text says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from ahnn.estimation import Status

DOCUMENT = Path(__file__).parents[3] / "docs" / "filter.md"


def test_every_snippet_runs_and_sees_a_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    snippets = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    assert len(snippets) == 2
    names: dict = {}
    for snippet in snippets:
        exec(snippet, names)
    result, state, rows = names["result"], names["state"], names["measurements"]
    assert rows[0].isfinite().sum(-1).tolist() == [4, 4, 1, 4, 4, 4, 0]
    assert bool((rows[0, :, 2][rows[0, :, 2].isfinite()] > 0.08).all())  # rad: above the horizon
    assert result.status.tolist() == state.status.tolist() == [Status.OK]
    assert int(result.measured.sum()) == 21
    assert float((result.means[0, -1] - names["x"][0])[:3].norm()) < 0.5  # km, of a sd of 1.8
    # Steps of other lengths, the same pass; the last row is that of the second sensor.
    assert torch.allclose(state.belief.mean[0, :3], names["x"][0, :3], atol=0.05, rtol=0.0)
    assert float(state.time) == 900.0
