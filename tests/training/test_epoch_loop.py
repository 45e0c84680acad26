"""Our loop over batches does what Lightning's does, bit for bit, for everybody who listens."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import pytest
import torch
from helpers import SPRING, data_module, ready_model
from lightning import Callback, Trainer

from ahnn.models import Optimisation
from ahnn.training.epoch_loop import HOOKS, EpochLoop


class Listener(Callback):
    """Hears all of a step and notes when, with the numbers it is given."""

    def __init__(self) -> None:
        self.heard: list[tuple[Any, ...]] = []

    def note(self, hook: str, trainer: Trainer, module: Any, *arguments: Any) -> None:
        """Note a hook with the weights at that time."""
        of_step = [float(torch.as_tensor(a).detach()) for a in arguments if isinstance(a, torch.Tensor | int)]
        of_step += [float(a["loss"]) for a in arguments if isinstance(a, dict)]
        gradients = [float(p.grad.square().sum()) for p in module.parameters() if p.grad is not None]
        weights = float(torch.cat([p.detach().flatten() for p in module.parameters()]).square().sum())
        self.heard.append((hook, trainer.global_step, of_step, gradients, weights))


def listener(*hooks: str) -> Listener:
    """Return a callback that defines these hooks alone."""
    methods = {h: (lambda self, *args, _h=h: self.note(_h, *args)) for h in hooks}
    return type("Some", (Listener,), methods)()


class Fitted(NamedTuple):
    """What is left of a training: weights, what was heard, counts of the loops, and who took the steps."""

    weights: list[torch.Tensor]
    heard: list[tuple[Any, ...]]
    counts: dict[str, Any]
    own: bool


def fitted(folder: Any, hooks: tuple[str, ...], *, own: bool, **changes: Any) -> Fitted:
    """Train a small map for some epochs, by our loop or by Lightning's."""
    data = data_module(SPRING, str(folder), precision=32)
    model, watch = ready_model("mlp", data), listener(*hooks)
    adam = partial(torch.optim.AdamW, lr=1e-2)
    model.optimisation = Optimisation(adam, partial(torch.optim.lr_scheduler.ExponentialLR, gamma=0.5))
    quiet = {"logger": False, "enable_checkpointing": False, "enable_progress_bar": False}
    options = {"max_epochs": 3, "accelerator": "cpu", "enable_model_summary": False, **quiet, **changes}
    trainer = Trainer(callbacks=[watch], **options)
    if own:
        EpochLoop.take(trainer)
    trainer.fit(model, data)
    loop: Any = trainer.fit_loop.epoch_loop
    weights = [p.detach().clone() for p in model.parameters()]
    return Fitted(weights, watch.heard, loop.state_dict(), getattr(loop, "heard", None) is not None)


def same(ours: Fitted, theirs: Fitted) -> bool:
    """Return whether two trainings went alike, bit for bit."""
    weights = all(map(torch.equal, ours.weights, theirs.weights))
    return weights and ours.heard == theirs.heard and ours.counts == theirs.counts


@pytest.mark.parametrize("hooks", [(), HOOKS, *((hook,) for hook in HOOKS)], ids=str)
def test_every_hook_is_heard_in_its_place(tmp_path, hooks):
    ours, theirs = (fitted(tmp_path, hooks, own=own) for own in (True, False))
    assert ours.own
    assert {name for name, *_ in ours.heard} == {*hooks}
    assert same(ours, theirs)


@pytest.mark.parametrize(
    ("changes", "moved"),
    [
        ({"gradient_clip_val": 1e-3}, True),
        ({"gradient_clip_val": 1e-5, "gradient_clip_algorithm": "value"}, True),
        ({"max_epochs": -1, "max_steps": 7}, True),
        ({"limit_train_batches": 3}, True),
        ({"val_check_interval": 2}, False),
    ],
    ids=str,
)
def test_options_of_the_trainer_hold(tmp_path, changes, moved):
    ours, theirs = (fitted(tmp_path, HOOKS, own=own, **changes) for own in (True, False))
    plain = fitted(tmp_path, (), own=True)
    assert ours.own
    assert same(ours, theirs)
    assert all(map(torch.equal, ours.weights, plain.weights)) != moved


@pytest.mark.parametrize(
    ("hooks", "changes"),
    [
        (("on_train_batch_start",), {}),
        ((), {"accumulate_grad_batches": 2}),
        ((), {"profiler": "simple"}),
        ((), {"precision": "bf16-mixed"}),
    ],
    ids=str,
)
def test_what_it_does_not_know_is_left_to_lightning(tmp_path, hooks, changes):
    ours, theirs = (fitted(tmp_path, hooks, own=own, **changes) for own in (True, False))
    assert not ours.own
    assert same(ours, theirs)
