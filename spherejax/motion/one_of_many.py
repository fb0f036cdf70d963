"""One of many runs as its lane sees it: how it starts, what is integrated, and the trajectory that comes of it.

The scene of one run is traced for all; what depends on the run alone are numbers.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from spherejax.foundations.checks import is_concrete
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, compile_scene, example_of, flatten_system
from spherejax.motion.assembly import CLOSING_TOLERANCE, Assembly
from spherejax.motion.audit import limits_of
from spherejax.motion.dynamics import state_rate
from spherejax.motion.implicit import with_structure
from spherejax.motion.integrate import Plan, audit_of, beginning, contacts_of, correction_for, room_of, stages_of
from spherejax.motion.lanes import Block, LaneOutcome, LaneProblem
from spherejax.motion.longest_step import longest_step
from spherejax.motion.many_sensitivities import problem_of_rows, start_of_rows
from spherejax.motion.paths import path_of
from spherejax.motion.programs import program_for
from spherejax.motion.quantities import magnitudes
from spherejax.motion.simulate import split, tolerances_of
from spherejax.motion.solvers.automatic import Choice
from spherejax.motion.start import known_start
from spherejax.motion.status import Status
from spherejax.motion.trajectory import Statistics, Trajectory


class Method(NamedTuple):
    """How to integrate (static).

    Attributes:
        choice: the solver, and why.
        rtol: relative tolerance.
        atol: absolute tolerance, or None for one by kind of component.
        max_steps: largest number of steps of a run.
        track_work: whether the work of each joint is integrated.
        block: how wide the block of lanes is.
        watch: names of quantities whose largest magnitudes are kept.
        by: names of the parameters whose sensitivities are integrated as well.
    """

    choice: Choice
    rtol: float
    atol: float | None
    max_steps: int
    track_work: bool
    block: Block
    watch: tuple[str, ...] = ()
    by: tuple[str, ...] = ()


class Numbers(eqx.Module):
    """What the right-hand side of one run is given.

    Attributes:
        theta: all numbers of the system.
        ahead: what follows from them alone.
        tolerances: relative and absolute, where they depend on the run.
        limits: of the audit.
    """

    theta: Float[Array, " p"]
    ahead: Any
    tolerances: Any
    limits: Any


class Start(NamedTuple):
    """One run, ready to go.

    Attributes:
        numbers: what the right-hand side is given.
        y0: flat state.
        may_run: whether it can be run.
        status: what is reported otherwise.
        assembly: how the start was made consistent.
    """

    numbers: Numbers
    y0: Float[Array, " size"]
    may_run: Array
    status: Int[Array, ""]
    assembly: Assembly


class Prepared:
    """What is known of all runs once one has been traced: the plan and the tolerances that they share."""

    def __init__(self, scene_of: Callable[[Any], Scene], method: Method, ts):
        self.scene_of, self.method, self.ts = scene_of, method, ts
        self.plan: Plan | None = None
        self.shared_tolerances: Any = None

    @property
    def contact_joints(self) -> tuple[str, ...]:
        """Names of the joints whose contacts are counted."""
        assert self.plan is not None
        return example_of(self.plan.structure).contact_joints

    def start(self, parameters) -> Start:
        """The start of one run, with its sensitivities as rows below the state where they are asked for."""
        by = self.method.by
        if not by:
            return self.start_of_state(parameters)

        def of_values(values):
            return self.start_of_state({**parameters, **dict(zip(by, values, strict=True))})

        return start_of_rows(of_values, jnp.stack([parameters[name] for name in by]))

    def start_of_state(self, parameters) -> Start:
        """Build the scene of one run and assemble its start."""
        method = self.method
        compiled = compile_scene(self.scene_of(parameters), track_work=method.track_work)
        system = compiled.system
        structure, theta = flatten_system(system)
        _, unknown = split(system)
        scalar = path_of(structure).scalar
        self.plan = plan = Plan(structure, unknown, scalar)
        theta = jnp.asarray(theta)
        tolerances = tolerances_of(system, method.choice.solver, method.rtol, method.atol)
        self.explanation = f"{method.choice.reason}; {tolerances.description}; first step by trial (Hairer)"
        limits = (tolerances.rtol, tolerances.atol)
        own = limits if not all(is_concrete(limit) for limit in limits) else None
        self.shared_tolerances = limits if own is None else None
        # What it changes has been said before the runs were traced; see `many.warn_of_starts`.
        start = known_start(system, self.ts)
        assembly, y0 = beginning(plan, theta, self.ts[0], None if start is None else start.assembly)
        legal = jnp.all(jnp.stack([jnp.array(True), *compiled.conditions]))
        closed = assembly.residual_after < CLOSING_TOLERANCE
        status = jnp.where(legal, jnp.where(closed, Status.SUCCEEDED, Status.START_NOT_CLOSED), Status.BAD_VALUE)
        audited = jax.lax.stop_gradient(jax.tree.map(jnp.asarray, limits_of(system, tolerances.rtol)))
        numbers = Numbers(theta, program_for(state_rate, structure, scalar).ahead(theta), own, audited)
        return Start(numbers, y0, legal & closed & jnp.all(jnp.isfinite(y0)), status, assembly)

    def problem(self) -> LaneProblem:
        """What every lane integrates."""
        plan, method = self.plan, self.method
        assert plan is not None
        rate = program_for(state_rate, plan.structure, plan.scalar)

        def controller_of(numbers: Numbers):
            limits = self.shared_tolerances if numbers.tolerances is None else numbers.tolerances
            return diffrax.PIDController(rtol=jnp.asarray(limits[0]), atol=jnp.asarray(limits[1]))

        problem = LaneProblem(
            with_structure(method.choice.solver, plan.structure),
            controller_of,
            lambda t, y, numbers: rate.inside(numbers.theta, numbers.ahead, t, y),
            correction_for(plan),
            contacts_of(plan.structure, plan.scalar),
            method.max_steps,
            watching(plan.structure, method.watch),
            longest_step(plan.structure, self.ts),
            audit_of(plan),
            room_of(plan),
        )
        return problem_of_rows(problem, plan.structure, rate) if method.by else problem

    def trajectory(self, start: Start, outcome: LaneOutcome) -> Trajectory:
        """One run as a trajectory."""
        plan = self.plan
        assert plan is not None
        n_steps = outcome.n_accepted + outcome.n_rejected
        stats = Statistics(
            n_steps,
            outcome.n_accepted,
            outcome.n_rejected,
            n_steps * stages_of(self.method.choice.solver),
            outcome.n_onsets,
            outcome.audit,
            self.explanation,
        )
        return Trajectory(
            ts=self.ts,
            ys=outcome.ys,
            system=plan.structure.system(start.numbers.theta),
            stats=stats,
            status=outcome.status,
            t_reached=outcome.t_reached,
            y_reached=outcome.y_reached,
            assembly=start.assembly,
            choice=self.method.choice.reason,
            scalar=plan.scalar,
        )


def watching(structure: Structure, names: tuple[str, ...]) -> Callable | None:
    """The magnitudes of quantities as a function (t, y, numbers) of one lane; None without names."""
    if not names:
        return None
    program = program_for(_magnitudes_of(names), structure)
    return lambda t, y, numbers: program(numbers.theta, t, y)


@lru_cache(maxsize=64)
def _magnitudes_of(names: tuple[str, ...]):
    """One function for the same names: programs are kept by function."""

    def watched(system, t, y):
        return magnitudes(system, t, y, names)

    return watched
