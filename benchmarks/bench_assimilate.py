"""The filter online: lines per second, latency, memory, kills and restarts, compared with the batch filter.

Position fixes every 10 s of a Molniya orbit, noise 0.1 km, through a pretrained model or the exact flow
(`--flow exact`), on one thread. Throughput and memory belong to one process that reads a file, writes
estimates with covariances, and saves its state every 1,000 lines, after a warm-up. Latency is measured on
lines that arrive one by one. The command is killed with SIGKILL.

    python benchmarks/bench_assimilate.py [--flow molniya_mechanical] [--lines 100000] [--repeats 5]
        [--kills 20] [--kill-lines 10000] [--seed 0]
"""

from __future__ import annotations

import argparse
import io
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import torch

import ahnn
from ahnn.assimilation import Assimilation, Reading, StreamSensor
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.output_rows import Rows
from ahnn.assimilation.session import Session
from ahnn.estimation import Gate, initial_belief
from ahnn.measurements import Position, schedule
from ahnn.systems import Molniya, exact_flow
from ahnn.types import Space
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process, unscented_filter

MODEL, EXACT, STEP, SD, NOISE = "molniya_mechanical", "exact", 10.0, 0.1, (1e-3, 1e-5)
START = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]


class Model(NamedTuple):
    """Process model of the stream: the flow, its interval, and the space of its states."""

    flow: Any
    interval: float
    space: Space

    @classmethod
    def of(cls, name: str) -> Model:
        """Return a shipped model, or the exact flow of its system."""
        run = ahnn.load(MODEL if name == EXACT else name)
        if name != EXACT:
            return cls(run.dynamics, run.dt, run.space)
        system = Molniya(**{key: own for key, own in run.config["system"].items() if key[0] != "_"})
        return cls(exact_flow(system), system.dt, system.space)


@torch.no_grad()
def write_measurements(path: Path, flow: Any, lines: int, seed: int) -> None:
    """Write a table of position fixes with noise, every 10 s from 10 s on."""
    x, noise = torch.tensor([START], dtype=torch.float64), torch.Generator().manual_seed(seed)
    with path.open("w") as file:
        file.write("time,x,y,z\n")
        for k in range(1, lines + 1):
            x = flow(x, STEP)
            q = (x[0, :3] + SD * torch.randn(3, generator=noise, dtype=torch.float64)).tolist()
            file.write(f"{k * STEP},{q[0]},{q[1]},{q[2]}\n")


def make(model: Model) -> Assimilation:
    """Return the filter."""
    q = torch.diag(torch.tensor(NOISE, dtype=torch.float64).repeat_interleave(3) ** 2)
    process = online_process(UnscentedKalmanFilter(gate=Gate(0.999999)), model.flow, model.interval, q)
    sensors = {"position": StreamSensor.of(Position(), SD, model.space)}
    return Assimilation(process, sensors, initial_belief([START], np.diag([1.0] * 3 + [1e-4] * 3)))


def resident() -> float:
    """Return the resident memory of this process in MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class OneByOne(io.BufferedReader):
    """A file whose lines arrive one by one."""

    def read1(self, size: int = -1, /) -> bytes:
        """Return the next line."""
        return self.readline(size)


def session(model: Model, folder: Path, name: str, source: Any) -> Session:
    """Return a session that reads a source and saves its state every 1,000 lines."""
    filtering, places = make(model), (str(folder / f"{name}.out"), folder / f"{name}.state")
    return Session(
        filtering, Lines(source), Rows(model.space.components, filtering.sensors, "csv"), *places, 1000
    )


def stream(model: Model, folder: Path, lines: int, repeats: int) -> dict[str, Any]:
    """Assimilate a file in this process, several times."""
    cpu, wall, memory = list[float](), list[float](), list[float]()
    for k in range(repeats):
        own = session(model, folder, f"all{k}", (folder / "all.csv").open("rb"))

        def watch(number: int, *_: object) -> None:
            if number % max(1, lines // 20) == 0:
                memory.append(resident())

        begin, spent = time.perf_counter(), time.process_time()
        own.run(watch if k == 0 else None)
        if k or repeats == 1:
            wall.append((time.perf_counter() - begin) / lines)
            cpu.append((time.process_time() - spent) / lines)
    settled = memory[2:]
    return {
        "lines a second of CPU time, median of repeats (bar 10,000)": f"{1 / median(cpu):,.0f}",
        "lines a second, wall clock": f"{1 / median(wall):,.0f}",
        "CPU time of a line [us], median, least and most of repeats": ", ".join(
            f"{1e6 * time:.1f}" for time in (median(cpu), min(cpu), max(cpu))
        ),
        "resident memory after a tenth, growth (bar 10 %)": f"{settled[0]:.0f} MB, "
        f"{100 * (max(settled) / settled[0] - 1):.2f} %",
    }


def alone(model: Model, folder: Path) -> dict[str, Any]:
    """Assimilate lines that arrive one by one."""
    took, last = list[float](), time.perf_counter()
    own = session(model, folder, "alone", OneByOne(io.FileIO(folder / "kills.csv")))

    def watch(*_: object) -> None:
        nonlocal last
        now = time.perf_counter()
        took.append(now - last)
        last = now

    spent = time.process_time()
    own.run(watch)
    cpu = (time.process_time() - spent) / len(took)
    whole = folder / "together.out"
    session(model, folder, "together", (folder / "kills.csv").open("rb")).run()
    return {
        "CPU time of a line that arrives alone [us]": f"{1e6 * cpu:.0f}",
        "latency of a line alone [ms], median, 99.9 %, worst (bar 20)": "{:.2f}, {:.2f}, {:.2f}".format(
            *(1e3 * np.quantile(took, [0.5, 0.999, 1.0]))
        ),
        "the same bytes as together": whole.read_bytes() == (folder / "alone.out").read_bytes(),
    }


def step(model: Model, rows: int = 2000) -> dict[str, Any]:
    """Return the CPU time of a filter step: its library call, without lines."""
    filtering = make(model)
    table = torch.zeros(rows, 3, dtype=torch.float64)
    x = torch.tensor([START], dtype=torch.float64)
    with torch.no_grad():
        for k in range(rows):
            x = model.flow(x, STEP)
            table[k] = x[0, :3]
    readings = [Reading((k + 1) * STEP, tuple(q), "position") for k, q in enumerate(table.tolist())]
    spent, done = time.process_time(), 0
    while done < rows:
        done += len(filtering.updates(readings[done : done + 500]))
    return {"CPU time of a reading without lines [us]": f"{1e6 * (time.process_time() - spent) / rows:.1f}"}


def command(folder: Path, flow: str, name: str) -> list[str]:
    """Return the command that assimilates the table `kills.csv`."""
    return [
        *(
            sys.executable,
            "-m",
            "ahnn.assimilate",
            f"pretrained={flow}",
            f"start={START}",
            "start_sd=[1,0.01]",
        ),
        *(
            f"measurements={folder / 'kills.csv'}",
            f"measurement.sd={SD}",
            f"plugins.ukf.process_noise={[*NOISE]}",
        ),
        *(f"output={folder / name}.out", f"state={folder / name}.state", "every=500"),
    ]


def killed(folder: Path, flow: str, kills: int, seed: int) -> dict[str, Any]:
    """Kill an assimilation at random moments, and compare its output with an uninterrupted one."""
    whole, out = folder / "whole.out", folder / "parts.out"
    subprocess.run(command(folder, flow, "whole"), check=True, stderr=subprocess.DEVNULL)
    size = whole.stat().st_size
    done = 0
    for target in sorted(random.Random(seed).randrange(size) for _ in range(kills)):
        process = subprocess.Popen(command(folder, flow, "parts"), stderr=subprocess.DEVNULL)
        while process.poll() is None and not (out.exists() and out.stat().st_size >= target):
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
        done += process.wait() == -signal.SIGKILL
    subprocess.run(command(folder, flow, "parts"), check=True, stderr=subprocess.DEVNULL)
    equal = out.read_bytes() == whole.read_bytes()
    return {f"all estimates bit-identical after {done} kills (bar: the last estimate)": equal}


def beside_batch(model: Model, path: Path, count: int = 500) -> dict[str, Any]:
    """Compare with the filter over a batch of rows."""
    table = torch.from_numpy(np.loadtxt(path, delimiter=",", skiprows=1, max_rows=count))
    filtering = make(model)
    estimate = [filtering.update(Reading(time_, tuple(values))) for time_, *values in table.tolist()][-1]
    steps = schedule(table[:, 0], table[None, :, 1:], model.interval)
    start = initial_belief([START], np.diag([1.0] * 3 + [1e-4] * 3))
    noise, r = filtering.process.noise, SD**2 * torch.eye(3, dtype=torch.float64)
    result = unscented_filter(model.flow, start, steps.measurements, Position(), noise, r, steps.dt)
    mean, covariance = result.means[0, -1], result.covariances[0, -1]
    sd = covariance.diagonal().sqrt()
    off = float(((estimate.mean - mean) / mean).abs().max())
    spread = float(((estimate.covariance - covariance) / torch.outer(sd, sd)).abs().max())
    return {
        f"mean compared with the batch filter after {count} lines, relative (bar 1e-12)": f"{off:.1e}",
        "covariance, relative to its deviations": f"{spread:.1e}",
    }


def main() -> None:
    """Print figures and their bars."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flow", default=MODEL, help=f"a shipped model, or {EXACT}")
    for name, default in (
        ("lines", 100_000),
        ("repeats", 5),
        ("kills", 20),
        ("kill-lines", 10_000),
        ("seed", 0),
    ):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    torch.set_num_threads(1)
    model = Model.of(options.flow)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_measurements(folder / "all.csv", model.flow, options.lines, options.seed)
        write_measurements(folder / "kills.csv", model.flow, options.kill_lines, options.seed + 1)
        parts = [
            lambda: beside_batch(model, folder / "kills.csv"),
            lambda: step(model),
            lambda: alone(model, folder),
            lambda: stream(model, folder, options.lines, options.repeats),
        ]
        if options.kills and options.flow != EXACT:  # the command follows a run
            parts.append(lambda: killed(folder, options.flow, options.kills, options.seed))
        for part in parts:
            for text, value in part().items():
                print(f"{text:75s} {value}", flush=True)


if __name__ == "__main__":
    main()
