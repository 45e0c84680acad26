"""Threads as OMP_NUM_THREADS says or one, a cache for every session, examples without clock and luck."""

from __future__ import annotations

import gc
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from compositions import shared
from hypothesis import settings

THREADS = os.environ.get("OMP_NUM_THREADS", "1")
torch.set_num_threads(int(THREADS))
settings.register_profile("same", deadline=None, derandomize=True, database=None)
settings.load_profile("same")


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Folder of generated data, shared by all workers of a session and never the user's."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder = str(shared / "cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AHNN_CACHE", folder)
        patch.setenv("OMP_NUM_THREADS", THREADS)
        yield folder


@pytest.fixture(scope="session", autouse=True)
def compositions() -> Iterator[None]:
    """Options of conf/ merged once in a session."""
    with shared():
        yield


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run on the spring, which stays as it is: a test that changes one copies it."""
    from entry import FIRST, call  # lightning, which many tests do without

    folder = tmp_path_factory.mktemp("finished") / "run"
    assert call("ahnn.train", *FIRST, f"run={folder}") == 0
    return folder


@pytest.fixture
def two(monkeypatch):
    """Two cores that the process may use, and one thread in each operation."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5}, raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield monkeypatch
    torch.set_num_threads(threads)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave to the slow suite all but one in n cases of a test that is marked `sampled(n)`."""
    seen: Counter[str] = Counter()
    for item in items:
        sampled = item.get_closest_marker("sampled")
        if sampled and item.get_closest_marker("slow") is None:
            test = item.nodeid.partition("[")[0]
            if seen[test] % sampled.args[0]:
                item.add_marker(pytest.mark.slow)
            seen[test] += 1


def pytest_collection_finish() -> None:
    """Leave modules and collected tests, a million objects, out of every later collection of garbage."""
    gc.collect()
    gc.freeze()
