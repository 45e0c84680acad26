"""A run of somebody else's, trained once, and a copy of it for each test."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from foreign import trained


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    return trained(tmp_path_factory.mktemp("foreign") / "run")


@pytest.fixture
def run(finished, tmp_path):
    return Path(shutil.copytree(finished, tmp_path / "run"))
