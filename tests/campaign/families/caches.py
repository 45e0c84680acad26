"""Caches with damaged bytes: the data are those that were generated, whatever the file holds."""

from __future__ import annotations

import logging
from functools import partial

import torch

from ahnn.data import store
from ahnn.data.generate import generate
from ahnn.systems import MassSpring

from .damage import damaged

SPRING = MassSpring(name="spring", dt=0.01, steps=20)


def cases(draw, folder):
    """Yield damaged caches."""
    logging.getLogger("ahnn").setLevel(logging.ERROR)
    recipe = store.recipe(SPRING, 4, 0)
    truth = generate(SPRING, 4, 0)  # in memory: what a damaged file is mapped to changes with it
    store.load_or_make(folder, recipe, lambda: [truth])
    (path,) = folder.glob("*.safetensors")
    good = path.read_bytes()
    while True:
        what, content = damaged(draw, good)
        yield what, partial(attempt, path, content, recipe, truth)


def attempt(path, content, recipe, truth) -> None:
    """Read a damaged cache."""
    path.write_bytes(content)
    found = store.load_or_make(path.parent, recipe, lambda: [truth])
    assert torch.equal(found.states, truth.states), "other states"
    assert torch.equal(found.times, truth.times), "other times"
