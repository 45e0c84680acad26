"""Models of the field and forces with hostile options, and weights whose fields are of another kind.

What is made is symplectic in one step, or follows the Euler-Lagrange equations; a force is finite; weights are loaded
as they were written or refused. All of it in a forked process of limited memory and time.
"""

from __future__ import annotations

import resource
import tempfile
from functools import partial
from pathlib import Path

import torch
from torch.func import jacrev, vmap

import ahnn
from ahnn.checkpoints import FORMAT, Weights, write_weights
from ahnn.cli import commandline
from ahnn.cli.compose import compose_job
from ahnn.cli.prepare import prepare
from ahnn.cli.settings import check_settings
from ahnn.dynamics import make_dynamics
from ahnn.dynamics.forces import Instant, make_force
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.stored import about_space
from ahnn.types import Space, Trajectories, Units

from .children import TRAINING, Child, plain
from .doors import taken

NAN, INF = float("nan"), float("inf")
NETWORK = {"width": 5, "depth": 2, "activation": "tanh"}
MAPS = {
    "sympnet": {"form": "G", "layers": 2, "scaling": "block"}, "sympnet LA": {"form": "LA", "layers": 2, "shears": 3, "scaling": "block"},
    "henon_net": {"layers": 2, "scaling": "none"}, "generalised_hnn": {"layers": 2, "scaling": "block"},
    "lagrangian": {"scaling": "minmax", "inertia": 1.5, "integrator": {"name": "rk4"}},
}  # fmt: skip
SIZES = [0, -1, 1, 3, 2.5, NAN, INF, 10**3, 10**7, 10**12, "x", "2", None, True, [], [2], {}]
ODD = {
    "layers": SIZES, "shears": SIZES, "dof": [0, -1, 3, 2.0, "2", None, 10**9, NAN, True], "form": ["LA", "G", "la", "x", None, 7, ["G"]],
    "scaling": ["minmax", "none", "block", "x", None, 7, []], "inertia": [0, -1.0, NAN, INF, [1.5, 2.0], [1.5], [1.0] * 3, [1.0, NAN], "x", None, [], {}],
    "network": [None, [], "x", {}, {"width": 5}, {**NETWORK, "odd": 1}, {**NETWORK, "width": 10**12}, {**NETWORK, "depth": 10**9}, {**NETWORK, "depth": 0},
                {**NETWORK, "width": 2.5}, {**NETWORK, "activation": "relu"}, {**NETWORK, "activation": None}, {**NETWORK, "width": NAN}, {**NETWORK, "width": "5"}],
    "integrator": [None, {}, "rk4", {"name": "x"}, {"name": "rk4", "odd": 1}, {"name": "leapfrog"}, {"name": "gl4"}, []], "odd": [1, None], "kind": ["x", None, 7],
}  # fmt: skip
"""Options of models, and values that some of them may take."""
FORCES = {
    "friction": {}, "friction_matrix": {"kind": "friction", "of": "matrix"}, "controls": {"kind": "actuation"}, "forcing": {"frequency": 2.0},
    "network": {"sees": ["q", "v"]}, "spring": {"stiffness": 2.0}, "central_attraction": {"mu": 2.0}, "oblateness": {"mu": 2.0, "radius": 1.0, "j2": 0.01},
}  # fmt: skip
NUMBERS = [0, 0.0, -1.0, 1.0, NAN, INF, -INF, 1e300, 10**400, "x", "1", None, True, [], [1.0], [1.0, 2.0], [1.0, NAN], [-1.0, 1.0], [[1.0, 0.0], [0.0, 2.0]],
           [[1.0, 2.0], [0.0, 1.0]], [[1.0, 2.0]], [[NAN, 0.0], [0.0, 1.0]], [[1.0, 0.0, 0.0]] * 3, {}, {"a": 1}]  # fmt: skip
KEYS = [
    "coefficient",
    "of",
    "network",
    "matrix",
    "frequency",
    "cosine",
    "sine",
    "sees",
    "stiffness",
    "mu",
    "radius",
    "j2",
    "mass",
    "kind",
    "odd",
    "scaling",
]
TEXTS = [
    "positions",
    "matrix",
    "constant",
    "friction",
    "spring",
    "minmax",
    ["q", "q"],
    ["u"],
    ["t"],
    ["x"],
    ["q", "v", "t", "u"],
    {"width": 3, "depth": 1},
]
WORDS = ["model.layers=0", "model.layers=-1", "model.layers=1e9", "model.layers=1000000000", "model.layers=x", "model.layers=2.5", "model.layers=null",
         "model.layers=[2]", "model.layers=.nan", "model.form=LA", "model.form=x", "model.form=null", "model.shears=0", "model.shears=5",
         "model.shears=1000000000000", "model.kind=henon_net", "model.kind=x", "model.kind=hamiltonian", "model.integrator=null", "model.integrator.name=gl4",
         "scaling=minmax", "scaling=none", "model.scaling=minmax", "loss=derivative", "loss.derivative=0.5", "loss=paper", "integrator=leapfrog", "integrator=gl4",
         "hamiltonian=generic", "hamiltonian=mass_matrix", "inputs=isotropic", "inputs=angles", "window=0", "window=3", "window=60", "window=1000", "forces=friction",
         "forces=controls", "forces=[friction,forcing]", "forces=forcing", "forces=springs", "forces=oblate_planet", "forces=x", "forces=[]", "forces=[friction,friction]",
         "model.forces.friction.coefficient=-1", "model.forces.friction.coefficient=[1,2]", "model.forces.forcing.frequency=0", "model.forces.forcing.frequency=2",
         "+model.forces.x.kind=friction", "network=tanh_24", "model.network.width=0", "model.network.depth=0", "model.network.width=1000000000", "sensor=positions",
         "sensor=states", "data.noise=0.1", "optimizer=levenberg_marquardt", "optimizer=geodesic", "recipe=first_order", "recipe=paper", "recipe=measurements",
         "system=cart_pole", "system=pendulum_damped", "system=molniya", "data.gaps=0.1", "weights=molniya_mechanical", "trainer.max_epochs=0"]  # fmt: skip
LIMIT = 3 * 2**30
"""Bytes that a case may take besides those of this process."""


def cases(draw, folder):
    """Yield a model, a force, a command line or weights, with some options changed."""
    while True:
        place, seed, kind = (
            Path(tempfile.mkdtemp(dir=folder)),
            draw.randrange(10**6),
            draw.choice(["make"] * 3 + ["fields"] * 2 + ["force"] * 3 + ["command"] * 3),
        )
        name = draw.choice(list(MAPS))
        keys = draw.sample(
            [*MAPS[name], "network", "dof", *draw.sample(list(ODD), 1)], 1 + (draw.random() < 0.3)
        )
        keys = [key for key in keys if kind != "make" or key not in ("dof", "kind")]
        odd = {key: draw.choice(ODD[key]) for key in keys if draw.random() < 0.8}
        if kind == "make":
            yield f"{name} {odd}", partial(apart, place, partial(made, name, odd, seed))
        elif kind == "fields":
            yield f"weights of {name} {odd}", partial(apart, place, partial(stored, place, name, odd, seed))
        elif kind == "force":
            force = draw.choice(list(FORCES))
            key = draw.choice([*FORCES[force], *draw.sample(KEYS, 2)])
            options = {**FORCES[force], key: draw.choice([*NUMBERS, *TEXTS])}
            yield f"force {force} {options}", partial(apart, place, partial(pushed, force, options, seed))
        else:
            model = draw.choice(["sympnet", "henon_net", "ghnn", "lnn", "srnn", "sympnet"])
            words = [f"model={model}", *draw.sample(WORDS, draw.randint(1, 2))]
            yield " ".join(words), partial(apart, place, partial(composed, place, words))


def apart(place: Path, work) -> None:
    """Do some work in a process of its own, and end as it does."""

    def limited() -> None:
        pages = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (pages + LIMIT, pages + LIMIT))
        try:
            work()
        except UserError as error:
            print(f"refused: {error}")  # noqa: T201
            raise SystemExit(2) from None

    child = Child(limited, place / "log")
    code = child.code(60.0)
    plain(child.said())
    assert code in (0, 2), f"exit code {code}: {child.said()[-300:]}"
    if code:
        raise UserError(child.said())


def spec(name: str, odd: dict) -> dict:
    """Return what a model is made of."""
    options = {**MAPS[name], "kind": name.partition(" ")[0], "dof": 2, "network": NETWORK, **odd}
    return {
        key: value for key, value in options.items() if not (key == "integrator" and key not in MAPS[name])
    }


def data(dof: int, seed: int) -> Trajectories:
    """Return trajectories of n coordinates."""
    draw = torch.Generator().manual_seed(seed)
    states = torch.randn(4, 30, 2 * dof, generator=draw, dtype=torch.float64).cumsum(1)
    return Trajectories(states, 0.1 * torch.arange(30, dtype=torch.float64).expand(4, -1))


def fitted(options: dict, seed: int):
    """Return a model with weights of some size, calibrated to data."""
    torch.manual_seed(seed)
    model = make_dynamics(**options).double()
    for parameter in model.parameters():
        parameter.data += 0.2 * torch.randn_like(parameter)
    model.fit(Statistics.of(data(options["dof"], seed)))
    return model.requires_grad_(False)


def made(name, odd, seed) -> None:
    """Make a model, and take a step."""
    options = spec(name, odd)
    with taken(not odd):
        model = fitted(options, seed)
    assert "odd" not in odd, "an unknown option is accepted"
    x = data(options["dof"], seed).states[:, 5]
    after = model(x, 0.1)
    assert bool(after.isfinite().all()), "a step is not finite"
    if options["kind"] != "lagrangian":
        n = options["dof"]
        jacobian = vmap(jacrev(lambda one: model(one[None], 0.1)[0]))(x)
        form = torch.zeros(2 * n, 2 * n, dtype=torch.float64)
        form[:n, n:], form[n:, :n] = torch.eye(n), -torch.eye(n)
        off = (jacobian.mT @ form @ jacobian - form).abs().max() / jacobian.abs().max() ** 2
        assert float(off) < 1e-9, f"a step is not symplectic, by {float(off):.1e}"


def stored(place, name, odd, seed) -> None:
    """Load weights beside which something else stands."""
    sound = spec(name, {})
    model = fitted(sound, seed)
    components = ("x", "y", "px", "py")
    space = Space("mine", components, Units("s", "m", "m/s", "J"), sound.get("inertia", 1.0))
    (place / "run").mkdir()
    about = {"format": FORMAT, "dynamics": spec(name, odd), "space": about_space(space), "dt": 0.1}
    write_weights(place / "run" / "weights.safetensors", Weights(model.state_dict(), about))
    with taken(not odd):
        run = ahnn.load(place / "run")
    assert "odd" not in odd, "an unknown option is accepted"
    start = data(2, seed).states[0, 5]
    found = run.predict(start, [0.0, 0.1, 0.2]).states[0]
    assert bool(found.isfinite().all()), "states that are not finite"
    if (
        spec(name, odd).get("integrator") == sound.get("integrator")
        and about["dynamics"].get("network") == NETWORK
    ):
        expected = model(model(start[None], 0.1), 0.1)[0]
        changes = {key for key, value in odd.items() if value != sound.get(key)}
        assert torch.allclose(found[-1], expected, rtol=1e-9) or changes <= {"scaling"}, (
            f"other states with {odd}"
        )


def pushed(name, options, seed) -> None:
    """Make a force of two coordinates, or three, and let it push."""
    dof = 3 if name == "oblateness" else 2
    force = make_force(name, dof, 1, options).double()
    draw = torch.Generator().manual_seed(seed)
    at = Instant(*(torch.randn(6, size, generator=draw, dtype=torch.float64) for size in (1, 1, dof, dof)))
    found = force(at)
    assert tuple(found.shape) == (6, dof), f"a force of shape {tuple(found.shape)}"
    large = any(value == 1e300 for value in options.values())
    assert large or bool(found.isfinite().all()), "a force that is not finite"
    assert options.get("odd", 0) == 0 and "odd" not in options, "an unknown option is accepted"  # noqa: PT018
    if name.startswith("friction"):
        assert float((found * at.v).sum(-1).max()) <= 0, "friction adds energy"


def composed(place, words) -> None:
    """Do everything that a training does before it writes or generates anything."""
    given = [word.partition("=")[0] for word in words]
    small = [word for word in TRAINING if word.partition("=")[0] not in given]
    small = [word for word in small if not (word.startswith("system.") and "system" in given)]
    commandline.check(commandline.read(words), "train")
    cfg = compose_job([*small, *words], place / "run")
    check_settings(cfg)
    prepare(cfg, asked=())
