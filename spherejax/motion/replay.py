"""A run made again on the steps that it took, for derivatives in reverse.

What an adaptive integrator did is not to be differentiated: its rejected steps and its choice of steps have derivatives
without bound or meaning. On the accepted steps, held fixed, the run is a composition of explicit Runge-Kutta steps,
whose reverse mode is stable, costs about five runs whatever the count of parameters, and holds one copy of the
right-hand side: it compiles in seconds. Sample times are step ends, and each step is recomputed on the way back.
"""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.motion.callbacks import without_host_checks
from spherejax.motion.dynamics import state_rate
from spherejax.motion.integrate import Options, Parameters, Plan, correction_for, landing_controller, wrapped
from spherejax.motion.programs import program_for


def can_be_replayed(solver: Any) -> bool:
    """Whether the steps of a method can be made again: those of an explicit Runge-Kutta method."""
    return isinstance(solver, diffrax.AbstractERK) and isinstance(solver.tableau, diffrax.ButcherTableau)


@eqx.filter_jit
def accepted_times(
    plan: Plan, options: Options, theta: Float[Array, " n_numbers"], y0: Float[Array, " size"], ts: Float[Array, " n"]
) -> Float[Array, " max_steps"]:
    """The ends of the steps that a run keeps [s]; infinity behind the last one.

    Args:
        plan: of a system without located contacts.
        options: how to integrate; `max_steps` is the length of the result.
        theta: all numbers of the system.
        y0: the flat state at the start.
        ts: sample times [s].
    """
    rate = program_for(state_rate, plan.structure, plan.scalar)
    with without_host_checks():
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, args: rate.inside(args.theta, args.ahead, t, y)),
            wrapped(options.solver, correction_for(plan), None),
            t0=ts[0],
            t1=ts[-1],
            dt0=None,
            y0=y0,
            args=Parameters(theta, rate.ahead(theta)),
            saveat=diffrax.SaveAt(steps=True, fn=lambda t, y, args: jnp.zeros(0)),
            stepsize_controller=landing_controller(options.controller, None, plan, ts),
            adjoint=options.adjoint,
            max_steps=options.max_steps,
            throw=False,
        )
    times: Any = solution.ts
    return times


def grid_through(accepted: np.ndarray, ts: np.ndarray) -> tuple[np.ndarray, Int[np.ndarray, " n"]]:
    """Step ends and sample times together, filled up to a power of two by the last, and the places of the samples."""
    inside = accepted[(accepted > ts[0]) & (accepted < ts[-1])]
    grid = np.unique(np.concatenate([inside, ts]))
    length = 2 ** int(np.ceil(np.log2(max(grid.size, 2))))
    return np.concatenate([grid, np.full(length - grid.size, grid[-1])]), np.searchsorted(grid, ts)


def replayed(
    plan: Plan, solver: Any, theta: Float[Array, " n_numbers"], y0: Float[Array, " size"], grid: Float[Array, " m"]
) -> Float[Array, "m size"]:
    """The states at the times of a grid, by one step of an explicit method between neighbors; differentiable."""
    rate, correct = program_for(state_rate, plan.structure, plan.scalar), correction_for(plan)
    parameters = Parameters(theta, rate.ahead(theta))
    A, c, b = (jnp.asarray(each) for each in _tableau_of(solver.tableau))

    @jax.checkpoint
    def step(y, ends):
        t, t_next = ends
        h = t_next - t

        def with_stage(k, row):
            i, a_i, c_i = row
            inner = y + h * jnp.sum(a_i[:, None] * k, 0)
            f = rate.inside(parameters.theta, parameters.ahead, t + c_i * h, inner)
            return jax.lax.dynamic_update_index_in_dim(k, f, i, 0), None

        k, _ = jax.lax.scan(with_stage, jnp.zeros((b.size, y.size)), (jnp.arange(b.size), A, c))
        y = y + h * jnp.sum(b[:, None] * k, 0)
        y = y if correct is None else correct(parameters, t_next, y)
        return y, y

    _, ys = jax.lax.scan(step, y0, (grid[:-1], grid[1:]))
    return jnp.concatenate([y0[None], ys])


def _tableau_of(tableau: diffrax.ButcherTableau) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients, instants and weights of the stages up to the last one with a weight."""
    b = np.asarray(tableau.b_sol)
    n = 1 + int(np.flatnonzero(b)[-1])
    A = np.zeros((len(b), len(b)))
    for i, row in enumerate(tableau.a_lower, start=1):
        A[i, :i] = row
    return A[:n, :n], np.concatenate([[0.0], tableau.c])[:n], b[:n]
