"""Many objects in one session: time, lines per second, memory, comparison with separate runs, kills.

Position fixes of satellites on Molniya orbits, noise 0.1 km, read from a table with an object column;
estimates with covariances go to a file, and a state is saved every 100,000 lines. The process model is the
exact J2 flow, or the pretrained 2x40 model (`molniya_generic_wide`).

    python benchmarks/bench_objects.py [--objects 30000] [--fixes 100] [--kills 20] [--seed 0] [--parquet]
        [--flows exact learned]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
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
from ahnn.assimilation import Assimilation, Catalogue, Reading, StreamSensor
from ahnn.assimilation.catalogue_rows import CatalogueRows
from ahnn.assimilation.catalogue_session import CatalogueSession
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.parquet_stream import ParquetRows
from ahnn.estimation import Belief, Gate, initial_belief
from ahnn.measurements import Position
from ahnn.systems import Molniya
from ahnn.systems.truth import exact_flow
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process

MODEL, SD, NOISE, INTERVAL, EVERY = "molniya_generic_wide", 0.1, (1e-3, 1e-5), 60.0, 100_000
P0 = np.diag([1.0] * 3 + [1e-6] * 3)
SYSTEM: dict[str, Any] = {
    **{"name": "molniya", "dt": INTERVAL, "steps": 1440, "altitude": [540.0, 560.0]},
    **{"eccentricity": [0.7, 0.8], "inclination": [60.0, 66.0], "raan": [0.0, 0.0]},
    "argument_of_periapsis": [270.0, 270.0],
}


def system() -> Molniya:
    """Return the satellites of the shipped models."""
    return Molniya(**SYSTEM)


def make_files(folder: Path, objects: int, fixes: int, seed: int, *, parquet: bool) -> None:
    """Write starts and fixes; objects are measured in turns, each at separate times."""
    satellites, draw = system(), np.random.default_rng(seed)
    flow, generator = exact_flow(satellites), torch.Generator().manual_seed(seed)
    x = satellites.initial_states(objects, generator)
    spread = torch.randn(x.shape, generator=generator, dtype=torch.float64)
    np.save(folder / "starts.npy", (x + spread * torch.from_numpy(np.sqrt(np.diag(P0)))).numpy())
    names, times = np.array([f"sat-{k}" for k in range(objects)]), np.zeros(objects)
    with (folder / "fixes.csv").open("w") as file:
        file.write("time,satellite,x,y,z\n")
        for _ in range(fixes):
            steps = draw.uniform(0.8, 1.0, objects) * INTERVAL
            x, times = flow(x, torch.from_numpy(steps)), times + steps
            noise = SD * torch.randn(objects, 3, generator=generator, dtype=torch.float64)
            order = draw.permutation(objects)
            rows = zip(times[order].tolist(), names[order], (x[:, :3] + noise)[order].tolist(), strict=True)
            file.writelines(f"{t!r},{name},{q[0]!r},{q[1]!r},{q[2]!r}\n" for t, name, q in rows)
    if parquet:
        from pyarrow import csv
        from pyarrow import parquet as pq

        pq.write_table(csv.read_csv(folder / "fixes.csv"), folder / "fixes.parquet")


def process(flow: str) -> Any:
    """Return the filter's process with the exact or the learned flow."""
    q = torch.diag(torch.tensor(NOISE, dtype=torch.float64).repeat_interleave(3) ** 2)
    model = exact_flow(system()) if flow == "exact" else ahnn.load(MODEL).dynamics
    return online_process(UnscentedKalmanFilter(gate=Gate(0.9999)), model, INTERVAL, q)


def beliefs(folder: Path) -> Belief:
    """Return the starts of all objects."""
    return initial_belief(np.load(folder / "starts.npy"), P0)


def session(
    folder: Path, flow: str, name: str, *, parquet: bool = False, every: int = EVERY
) -> CatalogueSession:
    """Return the session of a file."""
    space, start = system().space, beliefs(folder)
    sensors = {"gnss": StreamSensor.of(Position(), SD, space)}
    objects = [f"sat-{k}" for k in range(len(start.mean))]
    catalogue = Catalogue(process(flow), sensors, start, objects)
    rows = CatalogueRows(space.components, sensors, "parquet" if parquet else "csv")
    source: Any = folder / "fixes.csv"
    lines: Any = ParquetRows(str(folder / "fixes.parquet")) if parquet else Lines(source.open("rb"))
    places = str(folder / f"{name}.out"), folder / f"{name}.state"
    return CatalogueSession(catalogue, lines, rows, *places, every, objects="satellite")


def follow(folder: Path, flow: str, *, parquet: bool) -> dict[str, Any]:
    """Assimilate all fixes in this process."""
    torch.set_num_threads(1)
    begin, cpu = time.perf_counter(), time.process_time()
    memory, made = list[float](), session(folder, flow, flow, parquet=parquet)
    saved = made.filter.save

    def save(*given: Any) -> None:
        saved(*given)
        memory.append(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6)

    made.filter.save = save  # pyright: ignore[reportAttributeAccessIssue]
    made.run()
    wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
    settled = memory[len(memory) // 10 + 1 :] or memory
    return {
        "seconds, wall clock": round(wall, 1),
        "seconds of CPU time": round(cpu, 1),
        "lines a second, wall clock": round(made.counted / wall),
        "lines taken": made.counts["taken"],
        "most memory [MB]": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3),
        "growth of memory behind a tenth [%]": round(100 * (settled[-1] / settled[0] - 1), 1),
    }


def beside_solo(folder: Path, flow: str, fixes: int, count: int, seed: int) -> dict[str, Any]:
    """Compare the last rows of drawn objects with separate filters."""
    start = beliefs(folder)
    drawn = sorted(random.Random(seed).sample(range(len(start.mean)), count))
    wanted = {f"sat-{k}": k for k in drawn}
    readings: dict[str, list[Reading]] = {name: [] for name in wanted}
    for line in (folder / "fixes.csv").open():
        t, name, *values = line.rstrip().split(",")
        if name in wanted:
            readings[name].append(Reading(float(t), tuple(map(float, values))))
    last: dict[str, list[str]] = {}
    for line in (folder / f"{flow}.out").open():
        name = line.split(",", 2)[1]
        if name in wanted:
            last[name] = line.rstrip().split(",")
    sensors = {"gnss": StreamSensor.of(Position(), SD, system().space)}
    off, spread, one = 0.0, 0.0, process(flow)
    lower = np.tril_indices(6)
    for name, k in wanted.items():
        solo = Assimilation(one, sensors, Belief(start.mean[k : k + 1], start.chol[k : k + 1]))
        for reading in readings[name]:
            estimate = solo.update(reading)
        assert len(readings[name]) == fixes
        numbers = np.array([float(cell) for cell in last[name][8:35]])
        mean, covariance = estimate.mean.numpy(), estimate.covariance.numpy()
        sd = np.sqrt(np.diag(covariance))
        blocks = [
            np.abs(numbers[:6] - mean)[part] / np.linalg.norm(mean[part]) for part in (slice(3), slice(3, 6))
        ]
        off = max(off, *(float(block.max()) for block in blocks))
        spread = max(spread, float(np.abs((numbers[6:] - covariance[lower]) / np.outer(sd, sd)[lower]).max()))
    return {
        f"{count} objects compared with separate runs, relative (bar 1e-12)": f"{off:.1e}",
        "covariances, relative to their deviations": f"{spread:.1e}",
    }


def killed(folder: Path, flow: str, kills: int, seed: int) -> dict[str, Any]:
    """Kill a session at random moments, and compare its output with an uninterrupted session."""
    command = [sys.executable, __file__, "--folder", str(folder), "--flow", flow, "--name"]
    subprocess.run([*command, "whole"], check=True, stdout=subprocess.DEVNULL)
    whole, out = folder / "whole.out", folder / "parts.out"
    size, done = whole.stat().st_size, 0
    for target in sorted(random.Random(seed).randrange(size) for _ in range(kills)):
        running = subprocess.Popen([*command, "parts"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while running.poll() is None and not (out.exists() and out.stat().st_size >= target):
            time.sleep(0.001)
        time.sleep(random.Random(target).uniform(0, 0.05))
        running.send_signal(signal.SIGKILL)
        done += running.wait() == -signal.SIGKILL
    subprocess.run([*command, "parts"], check=True, stdout=subprocess.DEVNULL)
    return {f"all estimates bit-identical after {done} kills": out.read_bytes() == whole.read_bytes()}


def main() -> None:
    """Print figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in (("objects", 30_000), ("fixes", 100), ("kills", 20), ("seed", 0), ("solo", 20)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--kill-objects", type=int, default=300, help="each measured 40 times")
    parser.add_argument("--flows", nargs="+", default=["exact", "learned"])
    parser.add_argument("--parquet", action="store_true", help="files are Parquet, in and out")
    parser.add_argument("--place", help="folder for the files; a temporary one without")
    for name in ("folder", "flow", "name"):  # of one session in a separate process
        parser.add_argument(f"--{name}", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.folder and options.name:
        torch.set_num_threads(1)
        session(Path(options.folder), options.flow, options.name, every=1000).run()
        return
    if options.folder:
        print(json.dumps(follow(Path(options.folder), options.flow, parquet=options.parquet)))
        return
    with tempfile.TemporaryDirectory(dir=options.place) as name:
        folder = Path(name)
        make_files(folder, options.objects, options.fixes, options.seed, parquet=options.parquet)
        for flow in options.flows:
            print(f"{flow} flow, {options.objects:,} objects, {options.fixes} fixes of each", flush=True)
            command = [sys.executable, __file__, "--folder", name, "--flow", flow]
            command += ["--parquet"] * options.parquet
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
            found = json.loads(done.stdout)
            if options.solo and not options.parquet:
                found |= beside_solo(folder, flow, options.fixes, options.solo, options.seed)
            for text, value in found.items():
                print(f"  {text:60s} {value}", flush=True)
        if options.kills:
            small = folder / "small"
            small.mkdir()
            make_files(small, options.kill_objects, 40, options.seed + 1, parquet=False)
            for text, value in killed(small, "exact", options.kills, options.seed).items():
                print(f"{text:62s} {value}", flush=True)


if __name__ == "__main__":
    main()
