"""Where trajectories come from: simulated from a Hamiltonian, or given."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any, Protocol

import torch

from ahnn.arguments import Count, Seed, Within, checked
from ahnn.data import store
from ahnn.data.files.recordings import Recordings
from ahnn.data.generate import generate, generated
from ahnn.data.in_memory import content_of
from ahnn.memory import require_disk
from ahnn.systems import System
from ahnn.types import Space, Trajectories


class Source(Protocol):
    """Whole trajectories and what their numbers mean."""

    @property
    def space(self) -> Space:
        """What the numbers mean."""
        ...

    @property
    def truth(self) -> System | None:
        """The system whose equations are known, or None."""
        ...

    def recipe(self) -> dict[str, Any]:
        """Return all that determines the trajectories, as plain values."""
        ...

    def steps(self) -> int:
        """Return about how many steps the shortest trajectory has, without making any."""
        ...

    def read(self) -> Trajectories:
        """Return the trajectories."""
        ...


@checked
class Simulated:
    """Trajectories of a system with known equations, generated once and cached.

    Args:
        system: the ground truth.
        trajectories: how many.
        seed: of the initial states.
        cache: folder of generated data.
    """

    def __init__(self, system: System, *, trajectories: Count, seed: Seed, cache: str) -> None:
        self.truth, self.count, self.seed = system, trajectories, seed
        self.cache = Path(cache).expanduser()

    @property
    def space(self) -> Space:
        """What the numbers of the system mean."""
        return self.truth.space

    def check(self) -> None:
        """Raise UserError for more trajectories than the disk of the cache holds."""
        size = 8.0 * self.count * (self.steps() + 1) * len(self.space.components)
        if not store.place(self.cache, self.recipe()).exists():
            require_disk("data.trajectories, system.steps", "trajectories", size, self.cache)

    def recipe(self) -> dict[str, Any]:
        """Return system, count and seed."""
        return store.recipe(self.truth, self.count, self.seed)

    def steps(self) -> int:
        """Return the steps of a trajectory drawn for a trial."""
        return int(self.truth.durations(self.truth.initial_states(1, torch.Generator().manual_seed(0))).max())

    def read(self) -> Trajectories:
        """Return the trajectories, from the cache where they are in it; it holds no controls."""
        if self.truth.controls:
            return generate(self.truth, self.count, self.seed)
        make = lambda: generated(self.truth, self.count, self.seed)  # noqa: E731
        return store.load_or_make(self.cache, self.recipe(), make)


@checked
class Given(Recordings):
    """Trajectories that a user has in Python.

    Args:
        trajectories: states (B, T, 2n) and times (B, T) or (T,), NaN where a sample is absent; momenta that
            are all NaN, or left out, are unknown. Controls (B, T, m) of a space that names them.
        space: what the numbers mean.
        cut: as `Recordings` has it.
        gap: likewise.
        unsound: likewise.

    Raises:
        UserError: a space that means nothing, shapes that do not fit it, infinite numbers, or times that do
            not increase.
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
        super().__init__(space, [content], space.inertia, cut=cut, gap=gap, unsound=unsound)

    def recipe(self) -> dict[str, Any]:
        """Return the hash of the content."""
        given = {"given": self.space.name, "sha256": store.checksum(self.trajectories)}
        if (controls := self.trajectories.controls) is None:
            return given
        own = hashlib.sha256(store.content(controls)).hexdigest()
        return given | {"controls": own, "linear": self.trajectories.linear}
