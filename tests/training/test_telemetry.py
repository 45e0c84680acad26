"""What a training records of its steps, and when it writes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from ahnn.training.callbacks import Telemetry, telemetry


class Logger:
    """Keeps what it is given."""

    def __init__(self) -> None:
        self.written: list[tuple[int, dict[str, float]]] = []

    def log_metrics(self, metrics: dict[str, float], step: int) -> None:
        """Keep it."""
        self.written.append((step, metrics))


@pytest.fixture
def trainer() -> Any:
    """Return what a telemetry sees of a trainer after one step."""
    optimizer = SimpleNamespace(param_groups=[{"lr": 0.5}])
    parts = {"loggers": [Logger()], "optimizers": [optimizer], "callback_metrics": {"val/loss": 3.0}}
    return cast(Any, SimpleNamespace(global_step=1, **parts))


def record(watch: Telemetry, trainer: Any, steps: range) -> None:
    """Let a telemetry see so many steps; each loss is a tenth of its step."""
    for trainer.global_step in steps:
        watch.on_train_batch_end(trainer, cast(Any, None), {"loss": trainer.global_step / 10}, None, 0)


def expected(steps: range) -> list[tuple[int, dict[str, float]]]:
    """Return the records of these steps."""
    return [(k, {"train/loss": k / 10, "train/lr": 0.5}) for k in steps]


def test_records_wait_and_are_written_in_their_order_with_their_steps(trainer: Any, monkeypatch: Any) -> None:
    """One write at once, the next when it is due or the epoch ends; none twice."""
    monkeypatch.setattr(telemetry, "PATIENCE", float("inf"))
    watch, written = Telemetry(every=2), trainer.loggers[0].written
    record(watch, trainer, range(1, 10))
    assert written == expected(range(2, 3))
    watch.on_validation_end(trainer, cast(Any, None))
    assert written == [*expected(range(2, 10, 2)), (9, {"val/loss": 3.0})]


@pytest.mark.parametrize("end", ["on_train_end", "on_exception"])
def test_the_end_of_a_training_writes_what_still_waits(trainer: Any, monkeypatch: Any, end: str) -> None:
    """Also where an exception ends it between two validations."""
    monkeypatch.setattr(telemetry, "PATIENCE", float("inf"))
    watch = Telemetry(every=1)
    record(watch, trainer, range(1, 6))
    more = (KeyboardInterrupt(),) if end == "on_exception" else ()
    getattr(watch, end)(trainer, cast(Any, None), *more)
    assert trainer.loggers[0].written == expected(range(1, 6))
