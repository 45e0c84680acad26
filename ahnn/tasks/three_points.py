"""Three systems from 300 trajectories of four noisy states each (Celledoni, Eidnes & Myhr 2025)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from ahnn.rollouts import rollout
from ahnn.systems import ChainPendulum, System
from ahnn.systems.truth import SubstepsFlow, accurate_substeps, exact_flow
from ahnn.tasks.definition import Draw, FieldTask, Predict, numbers, states
from ahnn.tasks.free_forms import CubicWell, StiffChain, begin
from ahnn.tasks.shooting_fit import fitted_constants
from ahnn.types import Trajectories

TRAJECTORIES, STEPS, STEP, NOISE = 300, 3, 0.8, 0.05
TRAINED = 270
TESTED = 100


def well(constants: list[float]) -> System:
    """Return the Hénon-Heiles system with given coefficients."""
    a, b, c, d = constants
    return CubicWell(name="henon_heiles", a=a, b=b, c=c, d=d, dt=STEP, steps=STEPS)


def stiff_chain(constants: list[float]) -> System:
    """Return the chain with given stiffness and softness."""
    stiffness, softness = constants
    return StiffChain(name="fermi_pasta", stiffness=stiffness, softness=softness, dt=STEP, steps=STEPS)


def double_pendulum(constants: list[float]) -> System:
    """Return the double pendulum with given second mass, lengths and gravity."""
    mass, *lengths, gravity = constants
    options = {"masses": [1.0, mass], "lengths": lengths, "gravity": gravity}
    return ChainPendulum(name="double_pendulum", dt=STEP, steps=STEPS, **options)


def draw(k: int, *, form: Callable[[list[float]], System], constants: list[float]) -> Draw:
    """Draw noisy trajectories of four samples; the score is the error of the flow from other starts.

    The floor is the error of the true functional form with its constants fitted to the training trajectories.
    """
    system, generator = form(constants), numbers(k)
    flow, size = exact_flow(system), 2 * system.dof
    with torch.no_grad():
        exact = rollout(flow, begin(TRAJECTORIES, size, generator), STEP, STEPS + 1)
        starts = begin(TESTED, size, numbers(k, 1))
        truth = rollout(flow, starts, STEP, STEPS + 1)
    noisy = exact + NOISE * states(generator.standard_normal(exact.shape))

    def flow_error(predict: Predict) -> float:
        return float((predict(starts, STEPS, STEP) - truth).mean(1).norm(dim=-1).mean())

    def rms(predict: Predict) -> float:
        return float((predict(starts, STEPS, STEP) - truth)[:, 1:].square().mean().sqrt())

    def predict_of(some: Tensor) -> Predict:
        varied = SubstepsFlow(form(some.tolist()), accurate_substeps(system))
        return lambda x, steps, dt: rollout(varied, x, dt, steps + 1)

    def floor() -> float:
        known = torch.tensor(constants, dtype=torch.float64)
        return flow_error(predict_of(fitted_constants(predict_of, noisy[:TRAINED], STEP, known)))

    times = torch.arange(STEPS + 1, dtype=torch.float64) * STEP
    data = Trajectories(noisy, times)
    return Draw(data, system.space, (0.9, 0.05, 0.05), flow_error, floor=floor, also={"rms error": rms})


MEASURED = (
    "model=hnn",
    "sensor=recorded",
    "recipe=measurements",
    "data.measured=state",
    "loss.stages=[[whole,1.0]]",
    f"data.noise={NOISE}",
)
WAVES = "network=gaussian_process"


def task(title: str, form: Callable[[list[float]], System], constants: list[float]) -> FieldTask:
    """Build the task of a system."""
    learned = {"network": MEASURED, "gaussian_process": (*MEASURED, WAVES)}
    if form(constants).separable:
        learned["separable_gp"] = (*MEASURED, WAVES, "hamiltonian=separable")
    return FieldTask(
        f"{title} from {TRAINED} trajectories of {STEPS + 1} noisy states, {STEP:g} apart",
        "hakonnoren/learning_hamiltonian_noise, MIT; Celledoni, Eidnes & Myhr 2025, Physica D 472, 134471",
        f"norm of the mean error over {STEPS * STEP:g} units of time from {TESTED} exact states; the noise "
        f"is {NOISE:g} per component, and the floor is the true form with {len(constants)} free constants",
        "270 training trajectories instead of 285; the noise level is known",
        {},
        learned,
        partial(draw, form=form, constants=constants),
    )


TASKS: dict[str, FieldTask] = {
    "points_henon_heiles": task("Hénon-Heiles", well, [1.0] * 4),
    "points_fermi_pasta": task("Fermi-Pasta-Ulam-Tsingou chain", stiff_chain, [2.0, 1.0]),
    "points_double_pendulum": task("double pendulum", double_pendulum, [1.0] * 4),
}
