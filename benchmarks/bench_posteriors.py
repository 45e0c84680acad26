"""Which posterior has the right bands: Laplace's, an ensemble's, or Hamiltonian Monte Carlo's of a layer?

    python benchmarks/bench_posteriors.py FOLDER few
    python benchmarks/bench_posteriors.py FOLDER chaos

`few` is five trajectories of a pendulum, scored at all later times. `chaos` is ten trajectories of the
Hénon-Heiles system, scored 1, 2 and 5 Lyapunov times after the start. Each draw has its own trajectories,
noise and weights (data.seed and seed), and leaves an ensemble in FOLDER/CASE/draw_K, which a repeated command
reads. Forecasts are of 100 unseen trajectories from their true starts. Scored are their positions: the
continuous ranked probability score (CRPS), the fraction within two standard deviations, and the rms error, of

- laplace: bands of the member with the greatest evidence, to first order in the parameters;
- sampled: rollouts of that member for random parameters of Laplace's distribution;
- ensemble: the members as points;
- mixture: the members with their bands, `ahnn.Ensemble.band`;
- fitted, fitted mixture: both, without members whose chi-square exceeds twice the smallest;
- hmc: rollouts of that member for draws of its last layer's posterior (`benchmarks/last_layer.py`);
- layer: the same for draws of Laplace's approximation of that posterior.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import NamedTuple

import torch
from bench_ensemble_bands import SEED, UNSEEN, trained
from hamiltonian_monte_carlo import effective_draws, sampled, split_rhat
from last_layer import LastLayer
from omegaconf import OmegaConf
from torch import Tensor

from ahnn import Ensemble, load_ensemble
from ahnn.cli.parts import build_sensor, build_source
from ahnn.data import Simulated, SplitData
from ahnn.data.segments import whole
from ahnn.runs import Run
from ahnn.systems import exact_flow
from ahnn.types import Trajectories
from ahnn.uncertainty import mixture_crps, mixture_moments, sampled_rollouts
from ahnn_plugins.chaos import lyapunov_exponents

FEW = """experiment=pendulum_angles system.dt=0.05 system.steps=50 data.every=2 data.trajectories=10
    data.split=[0.5,0.3,0.2] data.batch_size=20 data.windows_per_epoch=40 trainer.max_epochs=6
    loss.stages=[[4,0.5],[whole,1.0,5]] loss.closing=10"""
CHAOS = """system=henon_heiles system.amplitude=[0.22,0.275] system.dt=0.25 system.steps=60
    hamiltonian=mechanical recipe=measurements data.measured=position data.noise=0.005 data.every=1
    data.trajectories=20 data.split=[0.5,0.3,0.2] data.batch_size=150 data.windows_per_epoch=750
    trainer.max_epochs=8 loss.stages=[[4,0.5],[16,1.0,40]] loss.closing=10"""
CASES = {"few": FEW, "chaos": CHAOS}
"""Words of `python -m ahnn.train` for each case."""
MEMBERS = 5
HORIZONS = (1, 2, 5)
"""Scored times of chaotic motion, in Lyapunov times."""
LONG = 400
"""Steps of the trajectories whose Lyapunov exponents are computed; the more chaotic half is used."""
CHAINS, WARMUP, DRAWS, LEAPS = 8, 30, 50, 3
FAILED = 2.0
"""Multiple of the smallest chi-square beyond which a training counts as failed."""
SHOWN = 48
"""Number of rollouts of sampled posteriors."""
KINDS = ("laplace", "sampled", "ensemble", "mixture", "fitted", "fitted mixture", "hmc", "layer")


class Unseen(NamedTuple):
    """Unseen trajectories.

    Attributes:
        truth: their exact states at equal steps.
        scored: indices of the scored samples, by name.
    """

    truth: Trajectories
    scored: dict[str, Tensor]

    @property
    def dt(self) -> float:
        """Step length."""
        return float(self.truth.times[0, 1] - self.truth.times[0, 0])

    @property
    def steps(self) -> int:
        """Number of steps up to the last scored sample."""
        return int(max(index.max() for index in self.scored.values()))


class Forecast(NamedTuple):
    """Members of a forecast as normals or points.

    Attributes:
        states: (S, B, T, M) positions.
        deviations: their standard deviations, or None.
    """

    states: Tensor
    deviations: Tensor | None = None

    def score(self, truth: Tensor, index: Tensor) -> tuple[float, float, float]:
        """Return CRPS, fraction within two standard deviations, and rms error at samples `index`."""
        truth, states = truth[:, index], self.states[:, :, index]
        own = None if self.deviations is None else self.deviations[:, :, index]
        crps = float(mixture_crps(truth, states, own).mean())
        variance = torch.zeros_like(truth) if own is None else own.square().mean(0)
        if len(states) > 1:
            _, spread = mixture_moments(states.unsqueeze(-1))
            variance = variance + spread[..., 0, 0]
        off = states.mean(0) - truth
        inside = float((off.abs() <= 2 * variance.sqrt()).double().mean())
        return crps, inside, float(off.square().mean().sqrt())


def unseen_of(run: Run, case: str) -> Unseen:
    """Return the unseen trajectories of a case."""
    cfg = OmegaConf.create(run.config)
    source = build_source(cfg)
    assert isinstance(source, Simulated)
    if case == "few":
        truth = Simulated(source.truth, trajectories=UNSEEN, seed=SEED, cache=cfg.data.cache).read()
        return Unseen(truth, {"all times": torch.arange(1, truth.states.shape[1])})
    system = replace(source.truth, steps=LONG)
    truth = Simulated(system, trajectories=2 * UNSEEN, seed=SEED, cache=cfg.data.cache).read()
    states, flow = truth.states, exact_flow(system)
    rates = lyapunov_exponents(flow, states, truth.times, system.dt, states.std((0, 1)))
    chosen = rates.argsort(descending=True)[:UNSEEN]
    time = 1 / float(rates[chosen].mean())
    samples = {f"{k} Lyapunov times": torch.tensor([round(k * time / system.dt)]) for k in HORIZONS}
    positions = states[chosen, :, : system.dof]
    every = positions[:, :: LONG // 10].flatten(0, 1)
    least = float(mixture_crps(positions[:, -1], every[:, None].expand(-1, UNSEEN, -1)).mean())
    print(
        f"Lyapunov time {time:.3g}, exponents {rates[chosen].min():.3g} to {rates.max():.3g}; CRPS of the "
        f"distribution of all states {least:.3g}",
        flush=True,
    )
    return Unseen(truth._replace(states=states[chosen], times=truth.times[chosen]), samples)


def drawn(run: Run) -> tuple[list[Run], list[Run], str]:
    """Return runs with draws of the last layer's posterior and of its approximation, and diagnostics."""
    cfg = OmegaConf.create(run.config)
    source = build_source(cfg)
    data = SplitData(source, list(cfg.data.split), build_sensor(cfg, source))
    posterior = LastLayer(run, whole(data.measured("train"), data.instrument()))
    normal = torch.randn(SHOWN, len(posterior.centre), generator=torch.Generator().manual_seed(1))
    begin = normal[:CHAINS].double()
    chains = sampled(posterior.density, begin, WARMUP, DRAWS, LEAPS, seed=2)
    worst, least = split_rhat(chains.draws).max(), effective_draws(chains.draws).min()
    width = chains.draws.flatten(0, 1).std(0)
    about = (
        f"{len(posterior.centre)} variables, acceptance {chains.acceptance:.2f}, step {chains.step:.2f}, "
        f"R-hat at most {worst:.3f}, at least {least:.0f} effective draws, standard deviations "
        f"{width.min():.2f} to {width.max():.2f} of the Gauss-Newton matrix's"
    )
    return posterior.runs(chains.thinned(SHOWN)), posterior.runs(normal.double()), about


def forecasts(ensemble: Ensemble, unseen: Unseen) -> tuple[dict[str, Forecast], str]:
    """Return the forecast of each kind, and remarks on the member with the greatest evidence."""
    each = [known for run in ensemble.runs if (known := run.uncertainty) is not None]
    chi_square = torch.tensor([known.about["chi_square"] for known in each])
    fitted = chi_square <= FAILED * chi_square.min()
    evidence = [known.about["log_evidence"] for known in each]
    place = evidence.index(max(evidence))
    best, known = ensemble.runs[place], each[place]
    start, steps, dt, n = unseen.truth.states[:, 0], unseen.steps, unseen.dt, ensemble.space.dof
    states = ensemble.rollouts(start, steps, dt)[..., :n]
    bands = torch.stack([run.band(start, steps, dt)[..., :n] for run in ensemble.runs])
    lengths = torch.full((len(start), steps), dt, dtype=torch.float64)
    random = sampled_rollouts(best.dynamics, start, lengths, known.spread, SHOWN)[..., :n]
    exact, linear, about = drawn(best)
    last, layer = (
        torch.stack([run.rollout(start, steps, dt)[..., :n] for run in runs]) for runs in (exact, linear)
    )
    found = {
        "laplace": Forecast(states[[place]], bands[[place]]),
        "sampled": Forecast(random),
        "ensemble": Forecast(states),
        "mixture": Forecast(states, bands),
        "fitted": Forecast(states[fitted]),
        "fitted mixture": Forecast(states[fitted], bands[fitted]),
        "hmc": Forecast(last),
        "layer": Forecast(layer),
    }
    every = ", ".join(f"{value:.3g}" for value in chi_square.tolist())
    return found, f"chi-square {every}; member {place + 1}, widened by {known.inflation:.3g}; {about}"


def summary(values: Sequence[float], factor: float = 1.0) -> str:
    """Return the median and the range of draws."""
    return f"{factor * median(values):.3g} ({factor * min(values):.3g} to {factor * max(values):.3g})"


@torch.no_grad()
def main() -> None:
    """Print the scores of each draw, and a table of their medians and ranges."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("folder", type=Path)
    parser.add_argument("case", choices=[*CASES])
    parser.add_argument("--draws", type=int, default=5)
    asked = parser.parse_args()
    unseen, found = None, []
    for k in range(1, asked.draws + 1):
        own = [f"members={MEMBERS}", f"seed={100 * k}", f"data.seed={k}"]
        folder = asked.folder / asked.case / f"draw_{k}"
        with torch.enable_grad():
            trained([*CASES[asked.case].split(), *own], folder)
        ensemble = load_ensemble(folder)
        unseen = unseen_of(ensemble.runs[0], asked.case) if unseen is None else unseen
        each, about = forecasts(ensemble, unseen)
        truth = unseen.truth.states[..., : ensemble.space.dof]
        places = [(at, name) for at in unseen.scored for name in KINDS]
        found.append({(at, name): each[name].score(truth, unseen.scored[at]) for at, name in places})
        print(f"draw {k}: {about}", flush=True)
        for (at, name), (crps, inside, error) in found[-1].items():
            print(f"  {at}, {name}: {crps:.3g}, {100 * inside:.3g} %, {error:.3g}", flush=True)
    print("| time | bands | CRPS | within two standard deviations, % | rms error |\n|---|---|---|---|---|")
    for at, name in found[0]:
        crps, inside, error = zip(*(draw[at, name] for draw in found), strict=True)
        print(f"| {at} | {name} | {summary(crps)} | {summary(inside, 100)} | {summary(error)} |")


if __name__ == "__main__":
    main()
