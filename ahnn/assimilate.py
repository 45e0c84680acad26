"""Assimilate measurements online: `python -m ahnn.assimilate run=DIR measurements=FILE|- start=[..]|FILE`.

run=DIR             a run folder; or pretrained=NAME, a model shipped with the package; ckpt=best
measurements=FILE   CSV with a header (time, sensor, numbers, sd_NAME) or JSON lines; - is standard input
start=[X,...]       the state at time=0; or FILE: YAML or JSON (mean, sd or covariance), an ephemeris, table,
                    element set, or output of an assimilation, with its epoch, frame and covariance; start=fit
                    fits the first measurements of FILE, fitted=20 of them, and filters those behind them
start_sd=[..]       its standard deviations, one for each component (of one degree of freedom q and p), or
                    [position,velocity], in place of a covariance in FILE
controls=FILE       of a model with controls: a table of times and controls, or numbers that are held; without
                    it they are columns of the measurements, and hold until a line that has others
epoch=2024-03-01T12:00:00       of time zero; else that of the data of the run, or of the start
frame=EME2000       also center=EARTH, time_system=UTC: where neither the run nor the start says them
output=FILE         estimate and covariance after each line, CSV or JSON lines; else standard output
state=FILE          saved every 1000 lines (every=N); the same command goes on with it after any stop
stations=FILE       YAML with any number of ground stations, their noise, masks and biases
orbit=FILE.yaml     in place of run=: an orbit determination (ahnn.orbit) that goes on; folder=DIR has its
                    files, start=fit fits the first measurements, fitted=N of them; orbit.KEY=VALUE sets its
                    keys; measurements=FILE are then a TDM, normal points or a table of stations
objects=COLUMN      whose a line is: many objects, each as if alone; start is a table of their states by id,
                    or one for all; every=N lines are taken together (100,000); Parquet in and out
shard=2/8           of objects those of the second of eight workers, by their names
states=FILE         of objects, at the end: their last states, a start of ahnn.predict: .csv, .parquet, .oem
window=SECONDS      late measurements are merged by replay; lines=N are kept for that at most
lag=SECONDS         each line also has the estimate of that long before, smoothed with what came since
measurement=NAME    what is measured; of several sensors: +measurement@sensors.NAME=OPTION for each
measurement.bias_sd=NUMBER      its bias is estimated; bias_memory=TIME lets it wander; or of sensors.NAME
plugins=NAME        the filter; plugins.ukf.process_noise is Q
gate=0.999999       rejects less probable measurements; reopens after plugins.ukf.patience=5 consecutive
rejections;
                    gate=none takes all
watch=true          a live view of state, 3 sigma, innovations and NIS on standard error; or --watch
figures=FOLDER      innovations, consistency and deviations at the end
oem=FILE            .oem or .xml: an ephemeris message at the end, of object=NAME
--trust             build any class named in the folder's config.yaml; only for files you trust
"""

from __future__ import annotations

import logging
from contextlib import nullcontext

from ahnn.cli.early_stops import ended
from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

USAGE = (
    "usage: python -m ahnn.assimilate run=DIR | pretrained=NAME | orbit=FILE measurements=FILE|- "
    "start=FILE|[..]|fit"
)


def assimilate(arguments: list[str]) -> None:
    """Assimilate the stream named on the command line; raises as `cli.stream` and `jobs.assimilating`."""
    with importing():
        from ahnn.cli.stream import read_stream
        from ahnn.jobs import assimilating

    stream = read_stream(arguments, USAGE)
    saved = stream.asked.state is not None
    with ended(lambda: "the same command goes on where it was") if saved else nullcontext():
        assimilating.assimilate(stream)


def main() -> None:
    """Entry point of `python -m ahnn.assimilate` and `ahnn-assimilate`."""
    run_command(assimilate, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
