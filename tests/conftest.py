"""One thread, a cache of its own for every test session, and examples that depend on neither clock nor luck."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from hypothesis import settings

torch.set_num_threads(1)
settings.register_profile("same", deadline=None, derandomize=True, database=None)
settings.load_profile("same")


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Folder of generated data, shared by the tests of a session and never the user's."""
    folder = str(tmp_path_factory.mktemp("cache"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AHNN_CACHE", folder)
        patch.setenv("OMP_NUM_THREADS", "1")
        yield folder
