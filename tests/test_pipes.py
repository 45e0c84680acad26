"""Standard output that nobody reads, that is full or closed: the usual code, and at most one message."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMMANDS = [["ahnn.train", "--help"], ["ahnn"], ["ahnn.data", "--help"]]


def ended(command, stdout, **options):
    run = [sys.executable, "-m", *command]
    done = subprocess.run(run, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False, **options)
    return done.returncode, done.stderr


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
@pytest.mark.sampled(3)
def test_a_reader_that_has_gone_ends_a_command_quietly(command):
    read, write = os.pipe()
    os.close(read)
    try:
        assert ended(command, write) == (128 + 13, "")
    finally:
        os.close(write)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
@pytest.mark.sampled(3)
def test_a_full_disk_behind_standard_output_is_one_message(command):
    with Path("/dev/full").open("w") as full:
        code, told = ended(command, full)
    assert code == 2
    assert told == "ahnn: standard output or a file: No space left on device\n"


def test_a_closed_standard_output_is_none():
    assert ended(COMMANDS[0], None, preexec_fn=lambda: os.close(1)) == (0, "")
