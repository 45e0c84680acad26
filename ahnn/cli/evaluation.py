"""Command line of the evaluation of a finished run."""

from __future__ import annotations

import torch

from ahnn.cli.parts import build_plugins, build_sensor, build_source, report_options
from ahnn.cli.reevaluation import Request, run_config
from ahnn.cli.unused_keys import refuse, unread_of_data, unread_of_plugins
from ahnn.data import SplitData
from ahnn.jobs.evaluating import Reevaluation
from ahnn.loading import load


def read_evaluation(arguments: list[str]) -> Reevaluation:
    """Build the evaluation requested on the command line.

    Raises:
        UserError: a missing run, or an override without effect on a finished one.
    """
    request = Request.of(arguments)
    run = load(request.source, request.ckpt)
    cfg = run_config(run.folder, request)
    torch.set_num_threads(cfg.threads)
    source = build_source(cfg)
    sensor = build_sensor(cfg, source)
    unread = (*unread_of_data(cfg.system, source, sensor), *unread_of_plugins(cfg.plugins))
    refuse(unread, request.overrides)
    splits = SplitData(source, list(cfg.data.split), sensor)  # no windows are needed
    return Reevaluation(
        run=run,
        ckpt=request.ckpt,
        folder=request.folder,
        name=request.name,
        label=cfg.label,
        splits=splits,
        plugins=build_plugins(cfg.plugins, splits),
        seed=cfg.evaluation.seed,
        report=report_options(cfg.evaluation),
    )
