"""The filter online: lines per second, latency, memory, kills and restarts, compared with the batch filter.

Position fixes of a Molniya orbit every 10 s, noise 0.1 km, pretrained mechanical model (2x32 network), one
thread. Throughput, latency and memory belong to one process that reads a file, writes estimates with
covariances, and saves its state every 1,000 lines. The command is killed with SIGKILL.

    python benchmarks/bench_assimilate.py [--lines 100000] [--kills 20] [--kill-lines 10000] [--seed 0]
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

import ahnn
from ahnn.assimilation import Assimilation, Reading, StreamSensor
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.output_rows import Rows
from ahnn.assimilation.session import Session
from ahnn.estimation import initial_belief
from ahnn.measurements import Position, schedule
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process, unscented_filter

MODEL, STEP, SD, NOISE = "molniya_mechanical", 10.0, 0.1, (1e-3, 1e-5)
START = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]


def truth(run: ahnn.Run, lines: int) -> torch.Tensor:
    """Return positions (lines, 3), every 10 s, the first at 10 s."""
    minutes = run.rollout(START, steps=lines // 6 + 1)[0]
    parts = [minutes if k == 0 else run.flow(minutes, k * STEP) for k in range(6)]
    return torch.stack(parts, dim=1).reshape(-1, 6)[1 : lines + 1, :3]


def write_measurements(path: Path, run: ahnn.Run, lines: int, seed: int) -> None:
    """Write a table of position fixes with noise."""
    exact = truth(run, lines)
    noisy = exact + SD * torch.randn(exact.shape, generator=torch.Generator().manual_seed(seed)).double()
    with path.open("w") as file:
        file.write("time,x,y,z\n")
        for k, (x, y, z) in enumerate(noisy.tolist(), 1):
            file.write(f"{k * STEP},{x},{y},{z}\n")


def make(run: ahnn.Run) -> Assimilation:
    """Return the filter."""
    q = torch.diag(torch.tensor(NOISE, dtype=torch.float64).repeat_interleave(3) ** 2)
    process = online_process(UnscentedKalmanFilter(), run.dynamics, run.dt, q)
    sensors = {"position": StreamSensor.of(Position(), SD, run.space)}
    return Assimilation(process, sensors, initial_belief([START], np.diag([1.0] * 3 + [1e-4] * 3)))


def resident() -> float:
    """Return the resident memory of this process in MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def stream(run: ahnn.Run, folder: Path, lines: int) -> dict[str, Any]:
    """Assimilate a file in this process."""
    took, memory, last = np.zeros(lines, dtype=np.float32), [], time.perf_counter()
    filtering = make(run)
    rows = Rows(run.space.components, filtering.sensors, "csv")
    with (folder / "all.csv").open("rb") as file:
        session = Session(filtering, Lines(file), rows, str(folder / "all.out"), folder / "all.state", 1000)

        def watch(number: int, *_: object) -> None:
            nonlocal last
            now = time.perf_counter()
            took[number - 2], last = now - last, now
            if number % max(1, lines // 20) == 0:
                memory.append(resident())

        cpu, last = time.process_time(), time.perf_counter()
        begin = last
        session.run(watch)
        wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
    settled = memory[2:]
    return {
        "lines a second, wall clock (bar 1,000)": f"{lines / wall:.0f}",
        "lines a second of CPU time": f"{lines / cpu:.0f}",
        "latency of a line [ms], median, 99.9 %, worst (bar 20)": "{:.2f}, {:.2f}, {:.2f}".format(
            *(1e3 * np.quantile(took, [0.5, 0.999, 1.0]))
        ),
        "resident memory after a tenth, growth (bar 10 %)": f"{settled[0]:.0f} MB, "
        f"{100 * (max(settled) / settled[0] - 1):.2f} %",
    }


def command(folder: Path, name: str) -> list[str]:
    """Return the command that assimilates the table `kills.csv`."""
    return [
        *(
            sys.executable,
            "-m",
            "ahnn.assimilate",
            f"pretrained={MODEL}",
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


def killed(folder: Path, kills: int, seed: int) -> dict[str, Any]:
    """Kill an assimilation at random moments, and compare its output with an uninterrupted one."""
    whole, out = folder / "whole.out", folder / "parts.out"
    subprocess.run(command(folder, "whole"), check=True, stderr=subprocess.DEVNULL)
    size = whole.stat().st_size
    done = 0
    for target in sorted(random.Random(seed).randrange(size) for _ in range(kills)):
        process = subprocess.Popen(command(folder, "parts"), stderr=subprocess.DEVNULL)
        while process.poll() is None and not (out.exists() and out.stat().st_size >= target):
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
        done += process.wait() == -signal.SIGKILL
    subprocess.run(command(folder, "parts"), check=True, stderr=subprocess.DEVNULL)
    equal = out.read_bytes() == whole.read_bytes()
    return {f"all estimates bit-identical after {done} kills (bar: the last estimate)": equal}


def beside_batch(run: ahnn.Run, path: Path, count: int = 500) -> dict[str, Any]:
    """Compare with the filter over a batch of rows."""
    table = torch.from_numpy(np.loadtxt(path, delimiter=",", skiprows=1, max_rows=count))
    filtering = make(run)
    for time_, *values in table.tolist():
        estimate = filtering.update(Reading(time_, tuple(values)))
    steps = schedule(table[:, 0], table[None, :, 1:], run.dt)
    start = initial_belief([START], np.diag([1.0] * 3 + [1e-4] * 3))
    noise, r = filtering.process.noise, SD**2 * torch.eye(3, dtype=torch.float64)
    result = unscented_filter(run.dynamics, start, steps.measurements, Position(), noise, r, steps.dt)
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
    parser.add_argument("--lines", type=int, default=100_000)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--kill-lines", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    run = ahnn.load(MODEL)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_measurements(folder / "all.csv", run, options.lines, options.seed)
        write_measurements(folder / "kills.csv", run, options.kill_lines, options.seed + 1)
        parts = [lambda: beside_batch(run, folder / "kills.csv"), lambda: stream(run, folder, options.lines)]
        if options.kills:
            parts.append(lambda: killed(folder, options.kills, options.seed))
        for part in parts:
            for text, value in part().items():
                print(f"{text:75s} {value}", flush=True)


if __name__ == "__main__":
    main()
