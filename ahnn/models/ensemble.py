"""Members of a deep ensemble trained together: one loop, one pass over the data, independent steps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any, cast, final

import torch
from lightning import LightningModule, Trainer
from torch import Tensor, nn

from ahnn.cores import each
from ahnn.dynamics import Dynamics, StackedDynamics
from ahnn.errors import UserError
from ahnn.models.module import LOOKS, AbstractModel
from ahnn.statistics import Statistics
from ahnn.training import Derivative, Objective, Recursive
from ahnn.training.finite import require_finite_loss, require_finite_weights
from ahnn.training.member_damping import StepTaken, member_damped_steps, together_in_steps
from ahnn.types import Window

INDEPENDENT = ("SGD", "Adam", "AdamW", "NAdam", "RAdam", "Adamax", "Adagrad", "RMSprop")
"""Optimisers of torch that update each weight independently of all other weights."""


@final
class EnsembleModel(LightningModule):
    """Members that differ in their initial weights and the order of their batches.

    Gradient steps minimise the sum of the losses: with an element-wise optimiser, each member takes the same
    steps as in a separate training run. Second-order steps have a separate damping for each member.

    Args:
        members: models of one configuration, each built with its seed.

    Raises:
        UserError: the steps of the optimiser would couple the members.
    """

    def __init__(self, members: Sequence[AbstractModel]) -> None:
        super().__init__()
        self.members = nn.ModuleList(members)
        self.scores: list[dict[str, float]] = [{} for _ in members]
        self._sums: list[dict[str, float]] = []
        self._rows = 0.0
        self.configure_optimizers()

    @property
    def models(self) -> list[AbstractModel]:
        """The members, in the order of their seeds."""
        return cast("list[AbstractModel]", [*self.members])

    @property
    def dynamics(self) -> Dynamics:
        """Dynamics of the first member."""
        return self.models[0].dynamics

    @property
    def about(self) -> dict[str, Any]:
        """Checkpoint metadata: that of the first member, and the number of members."""
        first = self.models[0].about
        return {**first, "settings": {**first.get("settings", {}), "members": len(self.members)}}

    def calibrate(self, statistics: Statistics) -> None:
        """Fit scalings, units and the unit of the loss of all members to the training split."""
        for model in self.models:
            model.calibrate(statistics)

    def learns_from(self, **about: Any) -> None:
        """Add metadata about the data to the checkpoints of all members, once available."""
        for model in self.models:
            model.learns_from(**about)

    def check(self, trainer: Trainer) -> None:
        """Raise UserError for settings that couple the members, or for several devices."""
        clip = trainer.gradient_clip_val or 0
        for name, fits, expected, received in (
            (
                "trainer.gradient_clip_val",
                clip == 0,
                "none with members, since it couples their gradients",
                clip,
            ),
            ("trainer.devices", trainer.world_size == 1, "one with members", trainer.world_size),
        ):
            if not fits:
                message = f"{name}: expected {expected}; received {received}. Leave it out, or use seeds="
                raise UserError(message)

    def optimizers_of_all(self) -> Any:
        """Return one optimiser for all members' weights; for second-order steps, a list with one per member.

        Raises:
            UserError: the steps of the optimiser would couple the members.
        """
        first = self.models[0]
        solo = first.configure_optimizers()
        self.automatic_optimization = first.automatic_optimization
        if not self.automatic_optimization:
            return [solo, *(model.configure_optimizers() for model in self.models[1:])]
        kind = type(solo["optimizer"] if isinstance(solo, dict) else solo)
        if kind.__name__ not in INDEPENDENT or not kind.__module__.startswith("torch.optim"):
            message = (
                "members: expected an optimizer that treats each weight separately, such as adamw, or "
                f"levenberg_marquardt; received {kind.__name__}. Use seeds= to train the members one after "
                "another"
            )
            raise UserError(message)
        return first.optimisation.optimizer(chain(*(model.dynamics.parameters() for model in self.models)))

    def configure_optimizers(self) -> Any:
        """Return the optimisers and the scheduler for Lightning."""
        optimizer, scheduler = self.optimizers_of_all(), self.models[0].optimisation.scheduler
        if scheduler is None or isinstance(optimizer, list):
            return optimizer
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": scheduler(optimizer), "interval": "epoch"},
        }

    def training_step(self, batch: Any, batch_idx: int) -> Tensor:
        """Return the sum of the members' losses; `batch` contains their batches one after another.

        Raises:
            TrainingError: the loss is not finite.
        """
        epochs, optimizers = self.trainer.max_epochs or 1, None
        if not self.automatic_optimization:
            counted, *others = cast("list[Any]", self.optimizers())
            optimizers = [counted, *(other.optimizer for other in others)]  # the first one counts the steps
        objectives = [model.curriculum.at(self.current_epoch, epochs) for model in self.models]
        loss = self.losses(objectives, batch, optimizers)
        if loss.device.type == "cpu" or batch_idx % LOOKS == 0:
            require_finite_loss(float(loss.detach()), f"in epoch {self.current_epoch}, batch {batch_idx}")
        return loss

    def on_validation_start(self) -> None:
        """Check the weights, and clear the sums of the last validation."""
        require_finite_weights(self, f"at step {self.trainer.global_step} in epoch {self.current_epoch}")
        self._sums, self._rows = [{} for _ in self.members], 0.0

    def validation_step(self, batch: Any, batch_idx: int) -> None:
        """Add the metrics of a batch to those of each member."""
        size = float(len(batch.start) if isinstance(batch, Window) else len(batch.values))

        def judged(model: AbstractModel) -> dict[str, Tensor]:
            return model.curriculum.judge.validation(model.dynamics, batch)

        found = (
            each(judged, self.models, self.device) if isinstance(batch, Window) else map(judged, self.models)
        )
        metrics, self._rows = [*found], self._rows + size
        for name in metrics[0]:
            values = [float(one[name]) for one in metrics]
            for sums, value in zip(self._sums, values, strict=True):
                sums[name] = sums.get(name, 0.0) + size * value
            mean = torch.tensor(values, dtype=torch.float64).mean()
            self.log(f"val/{name}", mean, batch_size=int(size), on_epoch=True, logger=False)

    def on_validation_epoch_end(self) -> None:
        """Set the scores of the members."""
        self.scores = [{f"val/{k}": v / self._rows for k, v in sums.items()} for sums in self._sums]

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add the metadata of the first member, as plain values."""
        checkpoint["ahnn"] = {**self.about, "dynamics": self.models[0].dynamics.spec}

    def _split(self, batch: Any) -> list[Any]:
        """Return the batch of each member."""
        count = len(batch.start if isinstance(batch, Window) else batch.values) // len(self.members)
        return [batch.rows(slice(k * count, (k + 1) * count)) for k in range(len(self.members))]

    def losses(self, objectives: Sequence[Objective], batch: Any, optimizers: Any) -> Tensor:
        """Return the sum of the losses of the members, with its graph, or after a second-order step of each.

        Residuals of single rows are computed for all members together.

        Args:
            objectives: objective of each member.
            batch: batches of all members, one after another along the first dimension.
            optimizers: optimiser of each member, for second-order steps.
        """
        first, objective = self.models[0], objectives[0]
        if self.automatic_optimization and isinstance(objective, Recursive | Derivative):
            stacked: Any = StackedDynamics([model.dynamics for model in self.models])
            return len(self.members) * first.loss(objective.residuals(stacked, batch))
        given = [None] * len(self.members) if self.automatic_optimization else optimizers
        dynamics, batches = [model.dynamics for model in self.models], self._split(batch)
        if not self.automatic_optimization and together_in_steps(
            objective, dynamics, self._plain(optimizers)
        ):
            groups = [one.param_groups[0] for one in optimizers]
            means = member_damped_steps(cast(Recursive, objective), dynamics, batches, groups)
            optimizers[0].step(StepTaken(means[0]).both)
            return means.sum()
        zipped = zip(self.models, objectives, batches, given, strict=True)
        return torch.stack([m.stepper.step(o, m.loss, m.dynamics, own, by) for m, o, own, by in zipped]).sum()

    def _plain(self, optimizers: Any) -> list[Any]:
        """Return optimisers without Lightning's wrappers."""
        return [getattr(one, "optimizer", one) for one in optimizers]
