"""The gradient of one number by many parameters, back along the steps of the run."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import SceneError
from spherejax.motion.integrate import Options, beginning
from spherejax.motion.many import built
from spherejax.motion.replay import accepted_times, can_be_replayed, grid_through, replayed
from spherejax.motion.simulate import simulate
from spherejax.motion.solvers.automatic import Choice
from spherejax.studies.sensitivity.forward import (
    Found,
    Method,
    Prepared,
    Wanted,
    observable_run,
    prepare,
    system_at,
    traced_numbers,
)
from spherejax.studies.sensitivity.unknowns import FlatBuild

ROOM = 16
"""Steps that the run may take when it is made again, beyond those that were counted."""


def refusal(flat: FlatBuild, numbers, choice: Choice, method: Method) -> str:
    """Why a run cannot be gone back along; empty where it can."""
    if not can_be_replayed(choice.solver):
        return f"reverse mode needs an explicit method, and this run has another one ({choice.reason})"
    contacts = system_at(flat, numbers, method.track_work).contact_joints
    if contacts:
        return (
            f"joint {contacts[0]!r} has contact onsets: behind them the steps of the run are too long for derivatives, "
            "which forward mode controls"
        )
    return ""


def reverse(flat: FlatBuild, numbers, times, wanted: tuple[Wanted, ...], method: Method) -> Found:
    """The run, and the gradient of the one number that is wanted of it.

    The start follows from the parameters in forward mode, which is cheap; the run is gone back along its steps.
    """
    (number,) = wanted
    prepared = prepare(flat, numbers, times, method)
    problem = refusal(flat, numbers, prepared.choice, method)
    if problem:
        raise SceneError(f"{problem}; leave mode= out")
    scene = built(flat, dict(zip(flat.unknowns.names, numbers, strict=True)))
    options = {"rtol": method.rtol, "atol": method.atol, "max_steps": method.max_steps}
    run = simulate(scene, times, solver=prepared.choice.solver, track_work=method.track_work, **options)
    numbers, plan = jnp.asarray(numbers), prepared.plan
    values, directions, _ = traced_numbers(flat, plan, numbers, jnp.ones_like(numbers), method.track_work)
    y0, y0_slopes = _beginning(prepared, values, directions)
    n_steps = 2 ** int(np.ceil(np.log2(int(run.stats.n_steps) + ROOM)))
    again = Options(prepared.options.solver, prepared.options.controller, diffrax.ForwardMode(), n_steps)
    theta = plan.theta(values, prepared.known)
    grid, places = grid_through(np.asarray(accepted_times(plan, again, theta, y0, prepared.ts)), np.asarray(times))
    value, (by_values, by_start) = _gradient(prepared, number, values, y0, jnp.asarray(grid), jnp.asarray(places))
    slopes = directions @ by_values + y0_slopes @ by_start
    observed = (np.asarray(value).reshape(1, 1), np.asarray(slopes).reshape(1, 1, -1))
    return Found(run, [observed], "it is the derivative of the run's own steps, whose errors nobody controls")


@eqx.filter_jit
def _beginning(prepared: Prepared, values, directions):
    """The start, and its derivatives along the directions."""

    def start(values):
        plan = prepared.plan
        return beginning(plan, plan.theta(values, prepared.known), prepared.ts[0], prepared.start)[1]

    def along(direction):
        return jax.jvp(start, (values,), (direction,))

    return jax.vmap(along, out_axes=(None, 0))(directions)


@eqx.filter_jit
def _gradient(prepared: Prepared, wanted: Wanted, values, y0, grid, places):
    """The number, and its derivatives by the numbers of the system and by the start."""

    def number(values, y0):
        plan = prepared.plan
        theta = plan.theta(values, prepared.known)
        ys = replayed(plan, prepared.choice.solver, theta, y0, grid)[places]
        return wanted.of(observable_run(prepared, theta, ys))[0, 0]

    return jax.value_and_grad(number, (0, 1))(values, y0)
