"""Derivatives of observables along time by every parameter: one integration of the run and its sensitivities."""

from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.model.system import System, compile_scene, flatten_system, split
from spherejax.motion.derivatives.through_touches import any_jump, warn_of_rosenbrock
from spherejax.motion.equations.contacts import abrupt_contacts
from spherejax.motion.equations.programs import path_of
from spherejax.motion.integration.one_run import run_and_slopes
from spherejax.motion.integration.problem import Plan, RunInputs, RunMethod
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.many import built
from spherejax.motion.runs.simulate import choice_for
from spherejax.motion.settings import RunSettings
from spherejax.motion.solvers.automatic import SolverChoice
from spherejax.motion.solvers.traits import is_linearly_implicit
from spherejax.motion.start.assembly import Assembly
from spherejax.motion.start.start_now import start_now
from spherejax.program_cache import cached_jit
from spherejax.studies.sensitivity.unknowns import FlatBuild


class WantedObservables(Protocol):
    """What is observed of a run; hashable, and equal where it observes the same, so that programs are found again."""

    def of(self, run: Trajectory) -> Array:
        """An array of shape (n, components)."""
        ...


class RunWithSlopes(NamedTuple):
    """A run, what was observed of it, and the derivatives.

    Attributes:
        run: the run.
        observed: values (n, components) and derivatives (n, components, p) of each observable.
        errors: how the errors of the derivatives are controlled, in words.
    """

    run: Trajectory
    observed: list[tuple[np.ndarray, np.ndarray]]
    errors: str


def system_at(flat: FlatBuild, numbers: Any, track_work: bool) -> System:
    """The compiled scene for some numbers."""
    scene = built(flat, dict(zip(flat.unknowns.names, numbers, strict=True)))
    return compile_scene(scene, track_work=track_work).system


def choice_at(flat: FlatBuild, numbers: Any, settings: RunSettings) -> SolverChoice:
    """The method for a run, chosen by the numbers themselves: they are known here, if traced later on."""
    system = system_at(flat, numbers, settings.track_work)
    is_large = path_of(flatten_system(system)[0]).scalar is False
    return choice_for(system, settings.rtol, settings.solver, explicit_only=is_large and settings.solver is None)


class PreparedStudy(eqx.Module):
    """A run that can be made.

    Attributes:
        plan: what it is compiled for (static).
        choice: which method is used, and why (static).
        method: how to integrate.
        known: numbers of the system that do not depend on the parameters, with zeros elsewhere.
        ts: sample times [s].
        start: the consistent start, where it does not depend on the parameters.
    """

    plan: Plan = eqx.field(static=True)
    choice: SolverChoice = eqx.field(static=True)
    method: RunMethod
    known: Float[Array, " n_numbers"]
    ts: Float[Array, " n"]
    start: Assembly | None


def prepare(flat: FlatBuild, numbers, times, settings: RunSettings) -> PreparedStudy:
    """Choose the method by the numbers, and find what of the system depends on the parameters."""
    settings = settings.checked()
    choice = choice_at(flat, numbers, settings)
    system = system_at(flat, numbers, settings.track_work)
    any_jump(system)
    method = RunMethod.of_settings(system, flatten_system(system)[0], settings.replaced(solver=choice.solver))
    found = []

    def traced(numbers):
        # Not staged: what does not depend on the parameters stays known.
        system = system_at(flat, numbers, settings.track_work)
        structure, _ = flatten_system(system)
        known, unknown = split(system)
        plan = Plan(structure, unknown, path_of(structure).scalar)
        found.append((plan, jnp.asarray(known), start_now(system, times)))
        return numbers

    jax.jvp(traced, (jnp.asarray(numbers),), (jnp.ones(len(numbers)),))
    plan, known, start = found[0]
    if not plan.unknown:
        raise SceneError(f"the scene does not depend on {', '.join(map(repr, flat.unknowns.names))}")
    return PreparedStudy(plan, choice, method, known, jnp.asarray(times), start)


def traced_numbers(flat: FlatBuild, plan: Plan, numbers, scale, track_work: bool):
    """What of the system follows from the parameters, its derivatives (scaled), and whether it is legal."""

    def values_of(numbers):
        scene = built(flat, dict(zip(flat.unknowns.names, numbers, strict=True)))
        compiled = compile_scene(scene, track_work=track_work)
        values = jnp.asarray(flatten_system(compiled.system)[1])[np.array(plan.unknown, int)]
        return values, (values, jnp.all(jnp.stack([jnp.array(True), *compiled.conditions])))

    slopes, (values, are_legal) = jax.jacfwd(values_of, has_aux=True)(numbers)
    return values, slopes.T * scale[:, None], are_legal


def forward(
    flat: FlatBuild, numbers, times, wanted: tuple[WantedObservables, ...], settings: RunSettings
) -> RunWithSlopes:
    """The run with its sensitivities.

    Args:
        flat: the builder.
        numbers: where the derivatives are taken, shape (p,).
        times: sample times [s].
        wanted: what is observed.
        settings: how to integrate.
    """
    prepared = prepare(flat, numbers, times, settings)
    if is_linearly_implicit(prepared.method.solver):
        warn_of_rosenbrock(abrupt_contacts(system_at(flat, numbers, settings.track_work)), prepared.method.solver, 4)
    numbers = jnp.asarray(numbers)
    scale = flat.unknowns.scales(numbers)
    values, directions, are_legal = traced_numbers(flat, prepared.plan, numbers, scale, settings.track_work)
    inputs = RunInputs(values, prepared.known, prepared.ts, prepared.start, are_legal)
    outcome, slopes, _ = run_and_slopes(prepared.plan, prepared.method, inputs, directions)
    observed = _observed(prepared, wanted, values, directions, outcome.ys, slopes)
    run = observable_run(prepared, prepared.plan.theta(values, prepared.known), outcome.ys)
    stats = replace(run.stats, n_steps=outcome.stats.n_steps)
    run = replace(run, stats=stats, ended=outcome.status, t_reached=outcome.t_reached)
    errors = "the errors of the derivatives are controlled"
    return RunWithSlopes(run, [(np.asarray(y), np.asarray(slopes / scale)) for y, slopes in observed], errors)


@cached_jit(what="the derivatives of what is observed")
def _observed(prepared: PreparedStudy, wanted: tuple[WantedObservables, ...], values, directions, ys, slopes):
    """What is observed, and its derivatives by the chain rule; their last axis are the parameters."""

    def observed(values, ys):
        run = observable_run(prepared, prepared.plan.theta(values, prepared.known), ys)
        return [each.of(run) for each in wanted]

    def along(direction, slope):
        return jax.jvp(observed, (values, ys), (direction, slope))

    results, derivatives = jax.vmap(along, out_axes=(None, -1))(directions, slopes)
    return list(zip(results, derivatives, strict=True))


def observable_run(
    prepared: PreparedStudy, theta: Float[Array, " n_numbers"], ys: Float[Array, "n size"]
) -> Trajectory:
    """A run as observables see it."""
    nothing, ts = jnp.zeros((), jnp.int64), prepared.ts
    none = jnp.zeros(0)
    return Trajectory(
        ts=ts,
        ys=ys,
        system=prepared.plan.structure.system(theta),
        stats=Statistics(nothing, nothing, nothing, nothing, jnp.zeros(0, jnp.int64), jnp.zeros(4)),
        ended=nothing,
        t_reached=ts[-1],
        y_reached=ys[-1],
        assembly=Assembly(ys[0], nothing, nothing, none, none, none),
        choice=prepared.choice.reason,
        scalar=prepared.plan.scalar,
    )
