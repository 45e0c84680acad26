"""A saved state is the one that was written, or refused with one message."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from ahnn.checkpoints import Weights, write_weights
from ahnn.estimation import Belief, FilterState, initial_belief, load_notes, load_state, save_state
from ahnn.estimation.saved_state import FORMAT
from ahnn.estimation.state import initial_state

NOTES = {"stream": "line 3", "of": "a cart"}
STATE = initial_state(initial_belief([[1.0, -2.0], [3.0, 4.0]], torch.eye(2)), 0.5)
REFUSED = "path: expected a file written by save_state, of this version; received .* Start over"


def same(state: FilterState) -> bool:
    """Whether a state has the bits of the one that was saved."""
    pairs = zip((*state.belief, *state[1:]), (*STATE.belief, *STATE[1:]), strict=True)
    return all(torch.equal(a, b) and a.dtype == b.dtype for a, b in pairs)


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("states") / "good"
    save_state(STATE, path, NOTES)
    assert same(load_state(path))
    assert load_notes(path) == NOTES
    return path.read_bytes()


def refused(path) -> None:
    for load in (load_state, load_notes):
        with pytest.raises(ValueError, match=REFUSED):
            load(path)


def test_any_flipped_bit_is_refused(saved, tmp_path):
    draw, path = np.random.default_rng(0), tmp_path / "state"
    for place in draw.choice(8 * len(saved), 400, replace=False):
        content = bytearray(saved)
        content[place // 8] ^= 1 << place % 8
        path.write_bytes(content)
        refused(path)


@pytest.mark.parametrize(("name", "value"), [("failed_step", -2), ("steps", -1), ("status", 9)])
def test_counters_out_of_range_are_refused(tmp_path, name, value):
    wrong = torch.full_like(getattr(STATE, name), value)
    with pytest.raises(ValueError, match=f"{name}: expected finite"):
        save_state(STATE._replace(**{name: wrong}), tmp_path / "state")


def test_any_other_length_is_refused(saved, tmp_path):
    path = tmp_path / "state"
    for length in [*range(12), *range(12, len(saved), 37), len(saved) - 1]:
        path.write_bytes(saved[:length])
        refused(path)
    path.write_bytes(saved + b"\0")
    refused(path)


def test_foreign_files_folders_and_pipes_are_refused(tmp_path):
    import os

    save_file({"mean": torch.zeros(1, 2)}, tmp_path / "foreign")
    write_weights(tmp_path / "weights", Weights({"mean": torch.zeros(1, 2)}, {"format": 2}))
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for path in tmp_path.iterdir():
        refused(path)


def test_a_state_of_the_earlier_format_is_refused_with_the_remedy(saved, tmp_path):
    (tmp_path / "state").write_bytes(saved)
    with safe_open(tmp_path / "state", framework="pt") as file:
        parts = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - it is no dict
        about = json.loads(file.metadata()["ahnn"])
    orders = json.dumps(about["orders"])
    save_file(parts, tmp_path / "state", {**NOTES, "format": "ahnn filter state 1", "orders": orders})
    refused(tmp_path / "state")


BEYOND = {
    "a mean that is not finite": {"mean": torch.full((2, 2), torch.nan, dtype=torch.float64)},
    "an infinite factor": {"chol": torch.full((2, 2, 2), torch.inf, dtype=torch.float64)},
    "a time that is not finite": {"time": torch.tensor(torch.nan, dtype=torch.float64)},
    "an unknown status": {"status": torch.tensor([0, 9])},
    "negative steps": {"steps": torch.tensor(-1)},
    "negative rejections": {"rejections": torch.tensor([0, -1])},
    "one member too few": {"repairs": torch.tensor([0])},
    "another dtype": {"steps": torch.tensor(1.0)},
    "a mean without members": {"mean": torch.zeros(2, dtype=torch.float64)},
    "a part too many": {"more": torch.zeros(2)},
}


@pytest.mark.parametrize("parts", BEYOND.values(), ids=BEYOND)
def test_numbers_beyond_the_limits_of_a_state_are_refused_under_a_right_checksum(parts, tmp_path):
    own = {**STATE.belief._asdict(), **STATE._asdict(), **parts}
    own.pop("belief")
    about = {"format": FORMAT, "orders": {k: list(range(v.ndim)) for k, v in own.items()}, "notes": {}}
    tensors = {name: part.clone().contiguous() for name, part in own.items()}
    write_weights(tmp_path / "state", Weights(tensors, about))
    with pytest.raises(ValueError, match=REFUSED):
        load_state(tmp_path / "state")


def test_what_could_not_be_loaded_is_not_saved(tmp_path):
    belief = Belief(torch.full((2, 2), torch.nan, dtype=torch.float64), STATE.belief.chol)
    with pytest.raises(ValueError, match="mean: expected finite"):
        save_state(STATE._replace(belief=belief), tmp_path / "state")
    assert list(tmp_path.iterdir()) == []


class Drawn(NamedTuple):
    """What an estimator of one's own carries beside time and status."""

    particles: torch.Tensor
    weights: torch.Tensor


class Cloud(NamedTuple):
    time: torch.Tensor
    status: torch.Tensor
    drawn: Drawn

    @property
    def moments(self):
        raise NotImplementedError


def cloud(count=5, dtype=torch.float64):
    particles = torch.arange(2 * count * 3, dtype=dtype).reshape(2, 3, count).mT  # no plain order in memory
    drawn = Drawn(particles, torch.full((2, count), torch.nan, dtype=dtype))
    return Cloud(torch.tensor(0.5, dtype=torch.float64), torch.zeros(2, dtype=torch.int64), drawn)


def test_a_state_of_an_estimator_of_ones_own_is_restored_and_any_other_is_refused(tmp_path):
    path, given = tmp_path / "state", cloud()
    save_state(given, path)
    found = load_state(path, like=cloud())
    assert isinstance(found.drawn, Drawn)
    for a, b in zip((*found[:2], *found.drawn), (*given[:2], *given.drawn), strict=True):
        assert a.dtype == b.dtype
        assert a.stride() == b.stride()
        assert torch.equal(a.nan_to_num(7), b.nan_to_num(7))
    for like in (cloud(4), cloud(dtype=torch.float32)):
        with pytest.raises(ValueError, match=rf"{REFUSED}") as refusal:
            load_state(path, like=like)
        assert "particles: expected torch.float" in str(refusal.value)
    with pytest.raises(
        ValueError, match=r"expected mean, chol, .*; received particles, status, time, weights"
    ):
        load_state(path)
    twice = given._replace(drawn=cloud())
    with pytest.raises(ValueError, match="parts with different names; received status, time twice"):
        save_state(twice, path)
