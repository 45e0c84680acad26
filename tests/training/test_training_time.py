"""The duration of a training that was resumed includes its earlier parts."""

from __future__ import annotations

import time
from types import SimpleNamespace

from ahnn.training.callbacks.training_time import timed_fit


def test_the_seconds_of_a_checkpoint_count():
    def fit(seconds):
        (clock,) = trainer.callbacks
        clock.load_state_dict({"seconds": 100.0})
        clock.on_fit_start(None, None)
        time.sleep(seconds)
        assert 100.0 + seconds <= clock.state_dict()["seconds"] < 110.0

    trainer = SimpleNamespace(callbacks=[], fit=fit)
    assert 100.02 <= timed_fit(trainer, seconds=0.02) < 110.0
