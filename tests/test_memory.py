"""Freed memory is kept for what comes."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PAGES = """
import resource
import torch
from ahnn.memory import keep_freed

keep_freed()

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

for count in (30, 10):
    before = faults()
    for _ in range(count):
        torch.ones(8_000_000, dtype=torch.float64)
print((faults() - before) * resource.getpagesize() / 8 / 8_000_000)
"""


@pytest.mark.skipif(not hasattr(os, "confstr"), reason="glibc alone keeps freed memory on request")
@pytest.mark.parametrize(("tuned", "tensors"), [({}, (0, 0.1)), ({"MALLOC_TRIM_THRESHOLD_": "0"}, (9, 11))])
def test_tensors_take_the_pages_of_those_before_unless_the_user_tunes_it(tuned, tensors):
    run = subprocess.run(
        [sys.executable, "-c", PAGES], env=os.environ | tuned, capture_output=True, text=True, check=True
    )
    low, high = tensors
    assert low <= float(run.stdout) <= high  # pages that came anew, in tensors of ten
