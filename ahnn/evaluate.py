"""Evaluate a finished run again: `python -m ahnn.evaluate run=DIR plugins=ukf`.

run=DIR             a run folder; its own config.yaml and weights are used
pretrained=NAME     a model that comes with the package; run=DIR says where its results are kept
ckpt=best           the weights to evaluate: best, last, or a path
name=NAME           of this evaluation, kept in DIR/evaluations/NAME; date and time without it
plugins=NAME        and measurement=NAME: groups of the library
KEY=VALUE           of system, data, evaluation, measurement and plugins: on other data, say
--trust             build whatever the folder's config.yaml names; only if you know who wrote it
"""

from __future__ import annotations

if __name__ == "__main__":  # until `guard` listens, Ctrl-C ends this process without a traceback
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)

import logging
import sys
from typing import Any

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

log = logging.getLogger("ahnn")

USAGE = "usage: python -m ahnn.evaluate run=DIR | pretrained=NAME [name=NAME] [plugins=.] [key=value]"


def evaluate(arguments: list[str]) -> None:
    """Evaluate the weights of a run and write the results into a folder of their own.

    Raises:
        UserError: no such run, or an override that has no effect on a finished one.
    """
    with importing():
        from ahnn.cli.again import Request, run_config
        from ahnn.cli.parts import build_plugins, build_sensor, build_source, report_options, robust_of
        from ahnn.cli.unread import refuse, unread_of_data, unread_of_plugins
        from ahnn.data import SplitData
        from ahnn.data.splits import SAME
        from ahnn.evaluation import evaluation_folder, load_results, report
        from ahnn.evaluation.prepare import make_case
        from ahnn.evaluation.sinks import TensorBoardSink
        from ahnn.evaluation.sinks.board import Board
        from ahnn.runs import load, weights_path

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    log.setLevel(logging.INFO)
    request = Request.of(arguments, USAGE)
    run = load(request.source, request.ckpt)
    cfg = run_config(run.folder, request)
    set_threads(cfg.threads)
    source = build_source(cfg)
    sensor = build_sensor(cfg, source)
    unread = (*unread_of_data(cfg, source, sensor), *unread_of_plugins(cfg.plugins))
    refuse(unread, request.overrides)
    splits = SplitData(source, list(cfg.data.split), sensor)  # it needs no windows
    plugins = build_plugins(cfg, splits)
    note = splits.beside(run.about.get("data"), run.about.get("seen") or ())
    remark = "" if note == SAME else f"test data: {note}"
    training = load_results(run.folder).training if (run.folder / "metrics.json").exists() else {}
    options = report_options(cfg)
    learned = {"uncertainty": run.uncertainty, "domain": run.domain, "robust": robust_of(run)}
    named = {"label": cfg.label, "seed": cfg.evaluation.seed, "remark": remark}
    if remark:
        log.warning(remark)
    last = request.ckpt == "best" and weights_path(run.folder).stem == "last"
    about = {"ckpt": "last" if last else request.ckpt, "data": note}
    known: dict[str, Any] = {**training, "val_loss": run.about.get("val_loss"), **about}
    with evaluation_folder(request.folder, request.name) as folder:
        case = make_case(run.dynamics, splits, folder=folder, **named, **learned)
        board = TensorBoardSink(Board(folder), about)
        report(case, plugins, known, more=[board] if cfg.evaluation.figures else [], **options)


def set_threads(count: int) -> None:
    """Set the number of threads of torch."""
    import torch

    torch.set_num_threads(count)


def main() -> None:
    """Entry point of `python -m ahnn.evaluate` and `ahnn-evaluate`."""
    run_command(evaluate, __doc__)


if __name__ == "__main__":
    main()
