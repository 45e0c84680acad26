"""Epochs that end at the mean of the weights of their steps."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from torch import nn
from torch.nn.utils import parameters_to_vector

from ahnn.errors import UserError
from ahnn.training.callbacks import EpochMean


def weights_of(module, places):
    with torch.no_grad():
        for place in places:
            for number, parameter in enumerate(module.parameters(), 1):
                parameter.fill_(number * place)
            yield


def epoch(mean, module, places, number=0, epochs=1):
    for k, _ in enumerate(weights_of(module, places)):
        trainer = SimpleNamespace(current_epoch=number, max_epochs=epochs, is_last_batch=k == len(places) - 1)
        mean.on_train_batch_end(trainer, module, None, None, k)


def test_the_last_epochs_end_at_the_mean_and_the_first_where_they_are():
    mean, module = EpochMean(0.5), nn.Linear(3, 2).double()
    addresses = [p.data_ptr() for p in module.parameters()]
    for number, place in ((0, 6.0), (1, 6.0), (2, 3.0), (3, 3.0)):
        epoch(mean, module, (1.0, 2.0, 6.0), number, 4)
        assert [float(p.detach().mean()) for p in module.parameters()] == [place, 2 * place]
    assert [p.data_ptr() for p in module.parameters()] == addresses


def test_what_an_interrupted_epoch_has_added_up_is_kept():
    module = nn.Linear(3, 2)
    whole, begun = EpochMean(1.0), EpochMean(1.0)
    epoch(whole, module, (0.1, 0.2, 0.7))
    expected = parameters_to_vector(module.parameters()).clone()
    trainer = SimpleNamespace(current_epoch=0, max_epochs=1, is_last_batch=False)
    for k, _ in enumerate(weights_of(module, (0.1, 0.2))):
        begun.on_train_batch_end(trainer, module, None, None, k)
    resumed = EpochMean(1.0)
    resumed.load_state_dict(begun.state_dict())
    epoch(resumed, module, (0.7,))
    assert torch.equal(parameters_to_vector(module.parameters()), expected)
    assert (resumed.steps, resumed.total.ndim) == (0, 0)


def test_none_are_averaged_unless_asked_for():
    mean, module = EpochMean(0.0), nn.Linear(1, 1)
    epoch(mean, module, (1.0, 2.0), 9, 10)
    assert float(module.weight.detach()) == 2.0
    with pytest.raises(UserError, match="fraction"):
        EpochMean(1.5)
