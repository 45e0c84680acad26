"""Predict with learned dynamics: `python -m ahnn.predict run=DIR | pretrained=NAME start=FILE duration=1d`.

run=DIR             a run folder, or [A,B,C]: the mean of several runs, with their spread
pretrained=NAME     a model shipped with the package
ckpt=best           the weights: best, last, or a path
start=FILE          first sample of each trajectory in a file (docs/data.md), an element set, or output
                    of an assimilation; or numbers in the model's units: [0.5,0], [[0.5,0],[0.7,0]]
start_sd=[..]       standard deviations of the start, one per component (q and p for one degree of freedom)
                    or [position,velocity]; default: the covariance in FILE, or none
controls=FILE       for a model with controls: a table of time and controls, or constants
duration=1d         duration with a unit, or a number in the model's unit of time
step=90min          interval of predicted states; default: the training interval
output=FILE         .csv, .parquet, .oem or .xml; default: only a summary
covariances=true    write covariances into tables, too; messages always contain them
samples=200         number of sampled paths, whose mean and covariance are written; default: first-order bands
output_frame=GCRF   frame of the output, GCRF or EME2000; default: the frame of the model
figure=FILE         .png or .svg
workers=2           number of processes that share many starts, or ray:2, tasks of Ray
epoch=2024-03-01T12:00:00       epoch of time zero, unless the start has dates
frame=[EME2000,EARTH,UTC]       frame, centre and time system, unless defined by model or file
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def predict(arguments: list[str]) -> None:
    """Predict as requested on the command line; raises the same errors as `jobs.predicting`."""
    with importing():
        from ahnn.cli.pairs import read_pairs
        from ahnn.jobs import predicting

    predicting.predict(read_pairs(arguments, predicting.PredictionRequest))


def main() -> None:
    """Entry point of `python -m ahnn.predict` and `ahnn-predict`."""
    run_command(predict, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
