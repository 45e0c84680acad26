"""One thread, a cache of its own for every test session, and no trace of Hydra between tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

torch.set_num_threads(1)


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Folder of generated data, shared by the tests of a session and never the user's."""
    folder = str(tmp_path_factory.mktemp("cache"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AHNN_CACHE", folder)
        patch.setenv("OMP_NUM_THREADS", "1")
        yield folder
