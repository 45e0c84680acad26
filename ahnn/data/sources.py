"""Sources of trajectories: simulated from a Hamiltonian, or given by the user."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

import torch

from ahnn.arguments import Count, Seed, Within, checked
from ahnn.data import store
from ahnn.data.files.content import CANONICAL
from ahnn.data.files.recordings import Recordings
from ahnn.data.generate import generate, generated
from ahnn.data.in_memory import content_of
from ahnn.measurements import Observations
from ahnn.memory import require_disk
from ahnn.systems import System
from ahnn.systems.drawn_states import drawn_states
from ahnn.types import Space, Trajectories


class Source(Protocol):
    """Source of trajectories with their state space."""

    @property
    def space(self) -> Space:
        """Description of the state components."""
        ...

    @property
    def truth(self) -> System | None:
        """System with known equations, or None."""
        ...

    def recipe(self) -> dict[str, Any]:
        """Return everything that determines the trajectories, as plain values."""
        ...

    def steps(self) -> int:
        """Estimate the number of steps of the shortest trajectory, without generating any."""
        ...

    def read(self) -> Trajectories:
        """Return the trajectories."""
        ...


@runtime_checkable
class Observed(Source, Protocol):
    """Source of measurements that are not state components; `read` returns positions derived from them."""

    def sensors(self) -> Any:
        """Return one measurement model of all its sensors, with their noise and biases."""
        ...

    def observations(self) -> Observations:
        """Return the measurements of all trajectories, (B, T, M), NaN where missing."""
        ...


@checked
class Simulated:
    """Trajectories of a system with known equations, generated once and cached.

    Args:
        system: true system.
        trajectories: number of trajectories.
        seed: seed of the initial states.
        cache: folder of generated data.
    """

    def __init__(self, system: System, *, trajectories: Count, seed: Seed, cache: str) -> None:
        self.truth, self.count, self.seed = system, trajectories, seed
        self.cache = Path(cache).expanduser()

    @property
    def space(self) -> Space:
        """Description of the system's state components."""
        return self.truth.space

    def check(self) -> None:
        """Raise UserError for more trajectories than fit on the disk of the cache."""
        size = 8.0 * self.count * (self.steps() + 1) * len(self.space.components)
        if not store.place(self.cache, self.recipe()).exists():
            require_disk("data.trajectories, system.steps", "trajectories", size, self.cache)

    def recipe(self) -> dict[str, Any]:
        """Return system, count and seed."""
        return store.recipe(self.truth, self.count, self.seed)

    def steps(self) -> int:
        """Return the number of steps of a trial trajectory."""
        return int(self.truth.durations(drawn_states(self.truth, 1, torch.Generator().manual_seed(0))).max())

    def read(self) -> Trajectories:
        """Return the trajectories, from the cache if present; the cache contains no controls."""
        if self.truth.controls:
            return generate(self.truth, self.count, self.seed)
        make = lambda: generated(self.truth, self.count, self.seed)  # noqa: E731
        return store.load_or_make(self.cache, self.recipe(), make)


@checked
class Given(Recordings):
    """Trajectories passed from Python.

    Args:
        trajectories: states (B, T, 2n) and times (B, T) or (T,), NaN where a sample is missing; momenta that
            are all NaN, or omitted, are unknown. Controls (B, T, m), if the space names any.
        space: description of the state components.
        cut: see `Recordings`.
        gap: see `Recordings`.
        unsound: see `Recordings`.

    Raises:
        UserError: an invalid space, incompatible shapes, infinite numbers, or times that do not increase.
    """

    def __init__(
        self,
        trajectories: Trajectories,
        space: Space,
        cut: Annotated[int, Within(2)] | None = None,
        gap: Annotated[float, Within(1.5)] = 10.0,
        unsound: bool = False,
    ) -> None:
        content = content_of(trajectories, space)
        mass = space.inertia if space.mechanical else CANONICAL
        super().__init__(space, [content], mass, cut=cut, gap=gap, unsound=unsound)

    def recipe(self) -> dict[str, Any]:
        """Return the hash of the content."""
        given = {"given": self.space.name, "sha256": store.checksum(self.trajectories)}
        if (controls := self.trajectories.controls) is None:
            return given
        own = hashlib.sha256(store.content(controls)).hexdigest()
        return given | {"controls": own, "linear": self.trajectories.linear}
