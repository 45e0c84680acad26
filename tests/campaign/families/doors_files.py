"""Doors and somebody's files: whatever a command is told to write, no file of others changes or goes.

A door is a command with one of the keys that say where is written. Its place holds files of our names that
we did not write, links, pipes and devices. Foreign content is the same before and after, bit for bit, and
nothing new lies behind a link that somebody put there.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from .children import TRAINING, trained
from .doors import MODEL, START, answered, assimilating, enter, fixes, numbers

NAMES = {
    "run": ["config.yaml", "metrics.json", "predictions.safetensors", "figures/error.png", "figures/mine.png",
            "checkpoints/last.ckpt", "checkpoints/best.ckpt", "checkpoints/mine.ckpt", "weights.safetensors",
            "tensorboard/hparams.yaml", ".ahnn-files", ".claim", ".turn", "console.log", ".hydra/config.yaml",
            "notes.txt", "figures", "checkpoints", "tensorboard", ".hydra", "posterior.safetensors"],
    "report": ["report.html", "tables.csv", "tables/scores_mass_spring.tex", "tables/mine.tex", "tables",
               "figures/mass_spring_rmse_true.png", "figures/mine.svg", "figures", ".ahnn-files", "notes.txt"],
    "evaluation": ["evaluations/mine/metrics.json", "evaluations/mine/figures/error.png", "evaluations/mine",
                   "evaluations", "evaluations/mine/predictions.safetensors", "evaluations/mine/notes.txt",
                   "evaluations/mine/.ahnn-files", "evaluations/mine/figures"],
    "export": ["flow.pt2", "energy.onnx", "weights.safetensors", "model.json", "notes.txt"],
    "pictures": ["innovations.png", "consistency.svg", "deviations.png", "mine.csv.png", "mine.csv.svg", "notes.txt",
                 ".ahnn-files"],
    "sweep": ["multirun.yaml", "0/config.yaml", "0/figures/mine.png", "0", "seed=7/config.yaml", "seed=7",
              "optimization_results.yaml", ".ahnn-files", "0/checkpoints/last.ckpt", "0/.hydra/config.yaml"],
    "reproduce": ["multirun.yaml", "MLP_7/config.yaml", "MLP_7/metrics.json", "MLP_7/figures/mine.png", "MLP_7",
                  "MLP_7/.turn", "MLP_7/checkpoints/last.ckpt", "MLP_7/checkpoints", ".ahnn-files"],
}  # fmt: skip
"""What each set of results writes, and a few names beside."""
KINDS = ["file", "file", "empty", "read-only", "link", "dangling", "link to a folder", "pipe", "device", "folder",
         "hard link", "temporary"]  # fmt: skip
LITTLE = [word for word in TRAINING if "max_epochs" not in word] + ["trainer.max_epochs=1"]
TINY = [word for word in LITTLE if word.startswith(("system.", "data.", "trainer.acc", "evaluation.fig"))]
PREDICT = [
    MODEL,
    f"start={numbers(START)}",
    "duration=10min",
    "epoch=2024-03-01T12:00:00",
    "frame=[GCRF,EARTH,UTC]",
]
STREAM = assimilating(Path("{place}/fixes.csv"))
FILES = {
    "predict output=.csv": ["predict", *PREDICT, "output={at}.csv"],
    "predict output=.oem": ["predict", *PREDICT, "output={at}.oem"],
    "predict output=.parquet": ["predict", *PREDICT, "output={at}.parquet"],
    "predict figure=": ["predict", *PREDICT, "figure={at}.png"],
    "predict output=start": ["predict", MODEL, *PREDICT[2:], "start={at}.oem", "output={at}.oem"],
    "assimilate output=": ["assimilate", *STREAM, "output={at}.csv"],
    "assimilate state=": ["assimilate", *STREAM, "output={place}/o.csv", "state={at}.state"],
    "assimilate oem=": ["assimilate", *STREAM, "output={place}/o.csv", "oem={at}.oem"],
    "assimilate output=measurements": ["assimilate", *assimilating(Path("{at}.csv")), "output={at}.csv"],
}
"""Doors that write a file, and their words; the ending of the name is that of the last word."""
REPRODUCE = ["reproduce", "system=mass_spring", "budget=smoke", *TINY, "experiment=paper_mlp", "seed=7"]
SHIPPED = ["data.trajectories=20", "system.steps=5", "evaluation.figures=false"]
FOLDERS = {
    "train run=": ("run", 1, ["train", *LITTLE, "run={at}"]),
    "train weights=": ("run", 1, ["train", *LITTLE, "weights={base}/run", "run={at}"]),
    "train ckpt=last": ("run", 1, ["train", *TRAINING, "run={at}", "ckpt=last"]),
    "train sweep": ("sweep", 1, ["train", "-m", *LITTLE, "seed=7", "hydra.sweep.dir={at}"]),
    "reproduce run=": ("reproduce", 1, [*REPRODUCE, "run={at}"]),
    "evaluate name=": ("evaluation", 4, ["evaluate", "run={at}", "name=mine", "plugins=none"]),
    "evaluate name=..": ("run", 2, ["evaluate", "run={at}", "name=..", "plugins=none"]),
    "evaluate pretrained": ("evaluation", 2, ["evaluate", MODEL, "run={at}", "name=mine", *SHIPPED]),
    "report output=": ("report", 4, ["report", "run={base}/run", "output={at}", "report.figures=false"]),
    "report beside": ("report", 4, ["report", "{at}", "report.figures=false"]),
    "export output=": ("export", 1, ["export", MODEL, "output={at}"]),
    "assimilate figures=": ("pictures", 3, ["assimilate", *STREAM, "output={place}/o.csv", "figures={at}"]),
    "data check figures=": ("pictures", 5, ["data.__main__", "check", "{place}/mine.csv", "figures={at}"]),
}
"""Doors that write a folder: their set of results, how often they are drawn, and their words."""
OURS = {"train ckpt=last", "evaluate name=", "evaluate name=..", "report beside"}
"""Doors of a folder that is a finished run, in which somebody put or changed something."""


def cases(draw, folder):
    """Yield a door, and what lies where it is told to write."""
    child = trained(folder / "run", "trainer.max_epochs=3")
    assert child.code() == 0, child.said()
    folders = [name for name, (_, weight, _) in FOLDERS.items() for _ in range(weight)]
    while True:
        place = Path(tempfile.mkdtemp(dir=folder))
        if draw.random() < 0.4:
            name, kind = draw.choice(list(FILES)), draw.choice(KINDS)
            yield f"{name} at a {kind}", partial(of_file, place, FILES[name], kind)
            continue
        name = draw.choice(folders)
        inside = [
            (each, draw.choice(KINDS)) for each in draw.sample(NAMES[FOLDERS[name][0]], draw.randint(1, 3))
        ]
        through = draw.choice(["", "", "", "a link", "read-only"])
        said = ", ".join(f"{each} a {kind}" for each, kind in inside)
        yield (
            f"{name} with {said}{through and f', {through}'}",
            partial(of_folder, place, name, inside, through),
        )


def spelled(words: list[str], place: Path, at: Path) -> list[str]:
    """Return the words of a command, with the files that it reads at their place."""
    fixes(place / "fixes.csv")
    rows = [(k * 0.1, 1 - (k * 0.1) ** 2 / 2, -k * 0.1) for k in range(12)]
    fixes(place / "mine.csv", rows, "t [s],q [m],v [m/s]")
    return [word.format(place=place, at=at, base=place.parent) for word in words]


def of_file(place: Path, words: list[str], kind: str) -> None:
    """Name a file that is there already."""
    door, *rest = spelled(words, place, place / "theirs")
    at = Path(rest[-1].partition("=")[2])
    planted = put(at, kind, place / "outside")
    assert planted is not None
    same(place, [planted], partial(enter, place, door, *rest))


def of_folder(place: Path, name: str, inside: list[tuple[str, str]], through: str) -> None:
    """Name a folder in which somebody's files lie."""
    at = place / "theirs"
    if name in OURS:
        shutil.copytree(place.parent / "run", at)
    at.mkdir(exist_ok=True)
    planted = [path for each, kind in inside if (path := put(at / each, kind, place / "outside"))]
    target = at
    if through == "a link":
        target = place / "link"
        target.symlink_to(at)
    if through == "read-only":
        at.chmod(0o555)
    door, *rest = spelled(FOLDERS[name][2], place, target)
    try:
        same(place, planted, partial(enter, place, door, *rest))
    finally:
        at.chmod(0o755)


def put(path: Path, kind: str, outside: Path) -> Path | None:
    """Put something of somebody's at a path, or near it; return where, None where it cannot be put there."""
    outside.mkdir(exist_ok=True)
    behind = outside / f"{len([*outside.iterdir()])}{path.suffix}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
    except OSError:  # another foreign thing is in its way
        return None
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero" if os.geteuid() else "/dev/full")
    elif kind == "folder":
        path.mkdir()
        (path / "mine.txt").write_text("mine")
    elif kind == "link to a folder":
        behind.mkdir()
        (behind / "mine.txt").write_text("mine")
        path.symlink_to(behind)
    elif kind == "dangling":
        path.symlink_to(behind.with_name(f"nothing{path.suffix}"))
    elif kind in ("link", "hard link"):
        behind.write_text("mine, elsewhere")
        path.symlink_to(behind) if kind == "link" else path.hardlink_to(behind)
    elif kind == "temporary":  # a name as our own unfinished files have
        path = path.with_name(f".{path.name}.{'0' * 32}.tmp")
        path.write_text("mine")
    else:
        path.write_text("" if kind == "empty" else "mine: 1\n")
        path.chmod(0o444 if kind == "read-only" else 0o644)
    return path


def same(place: Path, planted: list[Path], work: Callable[[], tuple[int, str]]) -> None:
    """Run a command; what was planted, and all that is behind a link, is the same afterwards."""
    roots = [*planted, place / "outside"]
    before = {key: value for root in roots for key, value in seen(root).items()}
    code, said = work()
    after = {key: value for root in roots for key, value in seen(root).items()}
    lost = [f"{path.relative_to(place)} ({was} -> {after.get(path, 'gone')})" for path, was in before.items()
            if after.get(path) != was]  # fmt: skip
    assert not lost, f"exit code {code}, lost {lost[:3]}: {said[-200:]}"
    new = [path for path in after.keys() - before.keys() if (place / "outside") in path.parents]
    assert not new, f"exit code {code}, written behind a link: {new[:3]}"
    answered(code, said)


def seen(path: Path) -> dict[Path, str]:
    """Return what lies at a path and below it, and its content; links are not followed."""
    if not os.path.lexists(path):
        return {}
    mode = path.lstat().st_mode
    if stat.S_ISLNK(mode):
        return {path: f"link to {os.readlink(path)}"}
    if stat.S_ISREG(mode):
        return {path: hashlib.sha256(path.read_bytes()).hexdigest()[:12]}
    if stat.S_ISDIR(mode):
        return {path: "folder"} | {key: value for each in path.iterdir() for key, value in seen(each).items()}
    return {path: "pipe" if stat.S_ISFIFO(mode) else "special"}
