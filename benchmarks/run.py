"""All works by ahnn and its peers, in turn; writes docs/benchmarks.md and its picture.

    python benchmarks/run.py [--only filter,rollouts] [--repeats 3]

Peers are in the extra `bench`; a peer that is not installed is reported and omitted. With `--only`, other
sections of the page stay unchanged. The script of each section can also be run by itself.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import bench_epoch
import bench_generation
import bench_second_order
import bench_startup
import bench_time_to_accuracy
import bench_training_step
import filter_works
import page
import works
from timing import left_out, settle, table

from ahnn.cli.preflight import quiet

CAP = 8.0
"""Times our time after which plain training is stopped."""
STEPS, WINDOWS = 150, 51200
"""Steps of a fit through Lightning, and windows of an epoch."""
OPENING = """# Benchmarks

`make bench` runs ahnn and other programs in turn, on identical work and one thread, and writes this page.
`python benchmarks/run.py --only filter,rollouts --repeats 3` repeats only these sections. Times are median
CPU times unless stated otherwise; ratios are medians over the repeats and are below 1 where ahnn is faster.

![Time of ahnn divided by the time of each other program](benchmarks.png)
"""


class Section(NamedTuple):
    """A section of the page: its heading, the text before its table, and its measurement."""

    title: str
    about: str
    measure: Callable[[int], str]
    repeats: int
    needs: Mapping[str, Sequence[str]]


SECTIONS = {
    "training": Section(
        "Training steps",
        """A step computes the Huber loss of recursive predictions over a window and its gradient, and
applies AdamW to a generic Hamiltonian network with three degrees of freedom, integrated by
RK4, in float32 and without Lightning. The floor is the time that PyTorch takes for the
network's multiply-adds as matrix products.

- **autograd.grad**: plain PyTorch, with the field as `autograd.grad` of the energy.
- **torchdiffeq**: the same field through `odeint(method="rk4")`, the 3/8 rule.
- **JAX**: Equinox and Optax, with the full step jitted; compilation time is excluded.

ahnn uses a fused optimiser and steps compiled from C, as in every training run; the other
PyTorch programs use the default optimiser.""",
        lambda repeats: table([*works.training(repeats)], "one step [ms]"),
        15,
        {peer: works.NEEDS[peer] for peer in ("torchdiffeq", "JAX")},
    ),
    "rollouts": Section(
        "Rollouts",
        """The network and the integrator are the same as in the training steps; all states are stored, as in
`run.rollout`. JAX jits the full rollout; diffrax takes constant steps with the classical
Runge-Kutta tableau.""",
        lambda repeats: table([*works.rollouts(repeats)], "1,440 steps [ms]"),
        7,
        works.NEEDS,
    ),
    "filter": Section(
        "The filter",
        """Each filter follows two-body motion with J2 and receives a position after every step, in float64.
`ahnn` uses the compiled flow of `system=molniya`, which has order eight and 17 stages. The other
columns take one Runge-Kutta step: `torch` is the ahnn filter with a flow in PyTorch, and
`compiled` adds `torch.compile`; dynamax and cuthbert are jitted; filterpy filters one trajectory
at a time. The floor is the time of the compiled flow on all sigma points, called from Python.""",
        lambda repeats: filter_works.table([*filter_works.filters(repeats)]),
        7,
        filter_works.NEEDS,
    ),
    "generation": Section(
        "Generation",
        """The task is to integrate 2,500 Molniya orbits about an oblate planet over one day, with one state
per minute. heyoka uses vectorised Taylor series; its time excludes compilation. DOP853 integrates
only five orbits, and its time is scaled up. Position errors are relative to heyoka at a tolerance
of 1e-18.""",
        bench_generation.generation,
        5,
        bench_generation.NEEDS,
    ),
    "second_order": Section(
        "Levenberg-Marquardt",
        """The table gives the time of one step in float64. The floor is the time of its matrix products;
optimistix takes a jitted step with the same network and number of residuals. Times on two cores
are wall-clock times and need an idle machine.""",
        bench_second_order.steps,
        3,
        bench_second_order.NEEDS,
    ),
    "lightning": Section(
        "Through Lightning",
        f"""Each fit takes {STEPS} steps with the default callbacks and TensorBoard, three layers of 128
units and batches of 256. `barebones` is Lightning's trainer without callbacks, a logger or checkpoints. The
bare loop uses ahnn's batches and optimiser; plain AdamW uses the PyTorch defaults.""",
        lambda repeats: table([*bench_training_step.measured(STEPS, repeats)], "one step [ms]"),
        3,
        {},
    ),
    "epoch": Section(
        "One epoch end to end",
        f"""An epoch has {WINDOWS:,} windows of the spring in batches of 256, with trajectories in memory.
ahnn runs a complete fit, including validation on 256 windows, a logger and a checkpoint. The plain loop
uses a per-sample DataLoader, the field as `autograd.grad` of the same network, and AdamW with
its defaults.""",
        lambda repeats: table([*bench_epoch.measured(WINDOWS, repeats)], "one epoch [s]", 1.0),
        3,
        {},
    ),
    "accuracy": Section(
        "Time to a given accuracy",
        f"""The table gives the time until rollouts of 25 validation trajectories reach the accuracy of AHNN5
in the paper, for the default recipe and for a plain training loop (one-step loss, AdamW with
batch size 256 from a per-sample DataLoader, autograd), which is stopped after {CAP:g} times ahnn's
time.""",
        lambda _: bench_time_to_accuracy.race(CAP),
        1,
        {},
    ),
    "startup": Section(
        "Start-up",
        """The training run ends after its first optimiser step, with trajectories and compiled parts cached.
The other programs take one AdamW step on random numbers, without configuration or data.""",
        bench_startup.startup,
        5,
        bench_startup.NEEDS,
    ),
}


def text(section: Section, repeats: int) -> str:
    """Measure a section, and return its text, which ends with the machine."""
    os.environ["OMP_NUM_THREADS"] = "1"  # a section before may have left two
    absent, load = left_out(section.needs), os.getloadavg()[0]
    found = section.measure(repeats)
    print(found, flush=True)
    times = "once" if repeats == 1 or section is SECTIONS["accuracy"] else f"{repeats} repeats"
    end = f"Measured on {page.machine(load)}; {times}."
    end += f" Not installed: {', '.join(absent)}." if absent else ""
    return f"{section.about}\n\n{found}\n{end}"


def chosen() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description="Measure ahnn and its peers; write docs/benchmarks.md.")
    parser.add_argument("--only", default=",".join(SECTIONS), help="sections, by comma: %(default)s")
    parser.add_argument("--repeats", type=int, help="of each section; by default what suits it")
    arguments = parser.parse_args()
    arguments.only = arguments.only.split(",")
    if unknown := {*arguments.only} - SECTIONS.keys():
        parser.error(
            f"--only: expected one or more of {', '.join(SECTIONS)}; received {', '.join(sorted(unknown))}"
        )
    return arguments


def main() -> None:
    """Measure, and write the page after each section."""
    arguments = chosen()
    quiet()
    settle()
    for key, section in SECTIONS.items():
        if key in arguments.only:
            print(f"## {section.title}", flush=True)
            found = {section.title: text(section, arguments.repeats or section.repeats)}
            page.write(OPENING, [one.title for one in SECTIONS.values()], found)


if __name__ == "__main__":
    main()
