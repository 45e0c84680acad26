"""One epoch end to end, including data loading: ahnn through Lightning, and a plain loop.

    python benchmarks/bench_epoch.py [windows] [repeats]

The plain loop takes windows one by one from a dataset, and a DataLoader stacks them; its field is
`autograd.grad` of the energy with its graph, its optimiser is AdamW with its defaults. Both use one network,
batches of 256 and trajectories in memory. For ahnn the complete fit counts, with checks, a validation of 256
windows, logger and checkpoint, which the plain loop lacks. CPU seconds.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator

import torch
import torch_peer
from bench_training_step import calibrated, configuration
from timing import Row, settle, table
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, RandomSampler

from ahnn.cli.preflight import quiet
from ahnn.cli.prepare import prepare

LENGTHS = (1, 5)


class Samples(Dataset):
    """Windows of trajectories, one at a time: a start (D,) and W increments (W, D)."""

    def __init__(self, states: Tensor, window: int) -> None:
        self.states, self.window = states, window
        self.each = states.shape[1] - window

    def __len__(self) -> int:
        return len(self.states) * self.each

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        trajectory, first = divmod(index, self.each)
        x = self.states[trajectory, first : first + self.window + 1]
        return x[0], x[1:] - x[:-1]


def loader(data, windows: int) -> DataLoader:
    """Return the loader of the plain loop."""
    samples = Samples(data.trajectories("train").states.float(), data.window)
    return DataLoader(samples, batch_size=256, sampler=RandomSampler(samples, num_samples=windows))  # pyright: ignore[reportArgumentType]


def seconds(work: Callable[[], object]) -> float:
    """Return the CPU seconds of one call."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def plain_epoch(batches: DataLoader, dt: float) -> None:
    """Train a generic Hamiltonian of one degree of freedom on all batches."""
    net = torch_peer.network(64, 2, "gelu", 2)
    optimizer = torch.optim.AdamW(net.parameters(), lr=1e-3)
    for start, targets in batches:
        optimizer.zero_grad()
        torch_peer.loss(net, torch_peer.increment, start, targets, dt).backward()
        optimizer.step()


def measured(windows: int, repeats: int) -> Iterator[Row]:
    """Yield rows for each length of windows: only loading, and the epoch."""
    for window in LENGTHS:
        load = Row(f"window {window}, batches only", {"ahnn": [], "plain loop": []}, None)
        epoch = Row(f"window {window}, full epoch", {"ahnn": [], "plain loop": []}, None)
        for repeat in range(-1, repeats):
            with tempfile.TemporaryDirectory() as folder:
                amount = f"data.windows_per_epoch={windows}"
                cfg = configuration(["model=ahnn", f"window={window}", amount, f"folder={folder}"])
                data, model = calibrated(cfg)
                trainer, batches, dt = prepare(cfg).trainer, loader(data, windows), data.statistics().dt
                found = (
                    (load, "ahnn", seconds(lambda data=data: [*data.train_dataloader()])),
                    (load, "plain loop", seconds(lambda batches=batches: [*batches])),
                    (epoch, "ahnn", seconds(lambda fit=trainer.fit, x=model, data=data: fit(x, data))),
                    (epoch, "plain loop", seconds(lambda b=batches, dt=dt: plain_epoch(b, dt))),
                )
            for row, who, spent in found if repeat >= 0 else ():  # the first warms up
                row.times[who].append(spent)
        yield from (load, epoch)


def main() -> None:
    """Print the table."""
    windows, repeats = (int(a) for a in (*sys.argv[1:], "51200", "5")[:2])
    quiet()
    settle()
    print(table([*measured(windows, repeats)], "one epoch [s]", 1.0))


if __name__ == "__main__":
    main()
