"""Assimilate measurements online: `python -m ahnn.assimilate run=DIR measurements=FILE|- start=[..]|FILE`.

run=DIR             a run folder; or pretrained=NAME, a model shipped with the package; ckpt=best
measurements=FILE   CSV with a header (time, sensor, numbers, sd_NAME) or JSON lines; - is standard input
start=[X,...]       the state at time=0; or FILE: YAML or JSON (mean, sd or covariance), an ephemeris, table,
                    element set, or output of an assimilation, with its epoch, frame and covariance; start=fit
                    fits the first fitted=20 measurements of FILE, and the filter continues after them
start_sd=[..]       standard deviations of the start, one per component (q and p for one degree of freedom)
                    or [position,velocity]; default: the covariance in FILE
time=NUMBER|DATE    time of a start that states none, by default 0; a date needs an epoch of time zero
controls=FILE       for a model with controls: a table of times and controls, or constants; default: columns
                    of the measurements, held until the next line that has values
epoch=2024-03-01T12:00:00       epoch of time zero; default: from the data of the run, or from the start
frame=EME2000       also center=EARTH, time_system=UTC: if neither the run nor the start states them
output=FILE         estimate and covariance after each line, CSV or JSON lines; default: standard output
state=FILE          saved every 1000 lines (every=N); repeat the command to resume after any interruption
stations=FILE       YAML with any number of ground stations, their noise, masks and biases
orbit=FILE.yaml     instead of run=: an orbit determination (ahnn.orbit) to continue; folder=DIR contains its
                    files, start=fit fits the first measurements (fitted=N), orbit.KEY=VALUE sets its keys;
                    measurements=FILE is then a TDM, normal points or a table of station measurements
objects=COLUMN      column with the object of each line (CSV or Parquet), for independent estimates; start is
                    a table of their states, or one for all; every=N lines form a batch (100,000)
shard=2/8           only the objects of the second of eight workers, selected by name
workers=2           number of processes that share the objects, or ray:2, tasks of Ray; state=FOLDER
states=FILE         final states of the objects, usable as start of ahnn.predict: .csv, .parquet, or .oem each
window=SECONDS      measurements late by up to this are merged by replay; at most lines=N are kept
lag=SECONDS         each line also contains the estimate for this much earlier, smoothed with later lines
measurement=NAME    measurement model; for several sensors +measurement@sensors.NAME=OPTION for each
measurement.bias_sd=NUMBER      estimate the bias of the sensor; bias_memory=TIME lets it drift
plugins=NAME        the filter; plugins.ukf.process_noise is Q
gate=0.999999       probability beyond which a measurement is rejected; the gate reopens after five
                    consecutive rejections (plugins.ukf.patience=5); gate=none accepts all
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


def assimilate(arguments: list[str]) -> None:
    """Assimilate the requested stream; raises the same errors as `cli.stream` and `jobs.assimilating`."""
    with importing():
        from ahnn.cli.sharded_stream import assimilate_sharded
        from ahnn.cli.stream import read_stream
        from ahnn.jobs import assimilating

    stream = read_stream(arguments)
    saved = stream.asked.state is not None
    with ended(lambda: "repeat the command to resume") if saved else nullcontext():
        if stream.asked.workers is None:
            assimilating.assimilate(stream)
        else:
            assimilate_sharded(stream, arguments)


def main() -> None:
    """Entry point of `python -m ahnn.assimilate` and `ahnn-assimilate`."""
    run_command(assimilate, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
