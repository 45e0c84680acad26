"""The cheapest of Lightning's profilers: fifty times a step it is asked to time nothing."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

from lightning.pytorch.profilers import PassThroughProfiler

_NOTHING: AbstractContextManager[None] = nullcontext()


class NoProfiler(PassThroughProfiler):
    """Hands out one context that does nothing, where Lightning's own makes a generator for each hook.

    `trainer.profiler=simple` puts one of Lightning's profilers in its place.
    """

    def profile(self, action_name: str) -> AbstractContextManager[None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a context that times nothing."""
        del action_name
        return _NOTHING
