"""TensorBoard serves what an evaluation wrote: scores, pictures, and hyper-parameters with their scores."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from urllib.error import URLError
from urllib.request import urlopen

import pytest
from cases import make_case

from ahnn.evaluation import report
from ahnn.evaluation.sinks.board import EventBoard

SECONDS = 120
"""Until it has started and read the folder; a few are enough."""
PREFIX = "Listening on "
SERVER = f"""
from tensorboard import program
import sys
board = program.TensorBoard()
board.configure(logdir=sys.argv[1], port=0, host="127.0.0.1", load_fast="false", reload_interval=1)
print({PREFIX!r} + board.launch(), flush=True)
sys.stdin.read()
"""


@pytest.fixture
def ask(tmp_path):
    """A function that asks a server on the folder of an evaluation for plain values or for a picture."""
    folder = tmp_path / "runs" / "mine"
    settings = {"seed": 7, "model": {"width": 64}}
    results = report(make_case(folder), {}, {"val_loss": 0.5}, boards=[(EventBoard(folder), settings)])
    command = [sys.executable, "-c", SERVER, str(tmp_path / "runs")]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, text=True, **pipes) as server:
        assert server.stdout is not None
        address = next(line for line in server.stdout if line.startswith(PREFIX)).removeprefix(PREFIX).strip()

        def get(path):
            with urlopen(f"{address}data/{path}") as answer:
                return answer.read()

        def until(path, name):
            deadline = time.monotonic() + SECONDS
            while time.monotonic() < deadline:
                try:
                    if name in (text := get(path).decode()):
                        return json.loads(text)
                except URLError:
                    pass
                time.sleep(0.3)
            raise AssertionError(path)

        try:
            yield results, get, until
        finally:
            server.communicate("", timeout=SECONDS)


def test_scores_pictures_and_hyperparameters_come_over_http(ask):
    results, get, until = ask
    tags = until("plugin/scalars/tags", "score/position")
    ((run, names),) = ((run, names) for run, names in tags.items() if "score/position" in names)
    assert {"score/val_loss", "score/velocity", "score/position/perturbed"} <= {*names}
    ((_, _, value),) = json.loads(get(f"plugin/scalars/scalars?run={run}&tag=score/position"))
    assert value == pytest.approx(results.rows[0].scores.position, rel=1e-6)

    pictures = until("plugin/images/tags", "phase_portrait")[run]
    (found, *_) = json.loads(get(f"plugin/images/images?run={run}&tag=phase_portrait&sample=0"))
    assert pictures["phase_portrait"]["samples"] == 1
    assert get(f"plugin/images/individualImage?{found['query']}")[:8] == b"\x89PNG\r\n\x1a\n"

    experiment = until("plugin/hparams/experiment?request=%7B%7D", "model.width")
    assert {"seed", "system", "assumes"} <= {each["name"] for each in experiment["hparamInfos"]}
    assert any(each["name"]["tag"] == "score/position" for each in experiment["metricInfos"])
