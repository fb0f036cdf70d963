"""Set-up of a batch: how each run of it starts, what is integrated, and the trajectory that its lane returns.

The scene of one run is traced for all; what depends on the run alone are numbers.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from spherejax.foundations.checks import is_concrete
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene, example_of, flatten_system, split
from spherejax.motion.equations.programs import path_of
from spherejax.motion.integration.asked import Asked
from spherejax.motion.integration.compiling import in_machine_code
from spherejax.motion.integration.integrate import Plan, stages_of
from spherejax.motion.integration.jobs import Job, JobKind, audit_limits, job_of, statistics, with_slopes
from spherejax.motion.integration.lanes import Block, LaneOutcome, LaneProblem
from spherejax.motion.integration.sensitivity_rows import scales_of
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.simulate import tolerances_of, traced_times
from spherejax.motion.solvers.automatic import SolverChoice
from spherejax.motion.start.jumps import jump_conditions
from spherejax.motion.start.start_now import known_start


class LaneMethod(NamedTuple):
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
        derivative_rtol: relative tolerance of these; None for what the method has.
    """

    choice: SolverChoice
    rtol: float
    atol: float | None
    max_steps: int
    track_work: bool
    block: Block
    watch: tuple[str, ...] = ()
    by: tuple[str, ...] = ()
    derivative_rtol: float | None = None


class PreparedRuns:
    """What is known of all runs once one has been traced: the plan and the tolerances that they share."""

    def __init__(self, scene_of: Callable[[Any], Scene], method: LaneMethod, ts):
        self.scene_of, self.method, self.ts = scene_of, method, ts
        self.plan: Plan | None = None
        self.shared_tolerances: Any = None

    @property
    def contact_joints(self) -> tuple[str, ...]:
        """Names of the joints whose contacts are counted."""
        assert self.plan is not None
        return example_of(self.plan.structure).contact_joints

    def start(self, parameters) -> Job:
        """One run as a job, with its sensitivities as rows below the state where they are asked for."""
        by = self.method.by
        if not by:
            return self.start_of_state(parameters)

        def of_values(values):
            return self.start_of_state({**parameters, **dict(zip(by, values, strict=True))})

        values = jnp.stack([parameters[name] for name in by])
        return with_slopes(of_values, values, jnp.diag(scales_of(values)))[0]

    def start_of_state(self, parameters) -> Job:
        """Build the scene of one run and assemble its start."""
        method = self.method
        compiled = compile_scene(self.scene_of(parameters), track_work=method.track_work)
        system = compiled.system
        structure, theta = flatten_system(system)
        _, unknown = split(system)
        self.plan = plan = Plan(structure, unknown, path_of(structure).scalar)
        tolerances = tolerances_of(system, method.rtol, method.atol)
        self.explanation = f"{method.choice.reason}; {tolerances.description}; first step by trial (Hairer)"
        pair = (tolerances.rtol, tolerances.atol)
        own = pair if not all(is_concrete(each) for each in pair) else None
        self.shared_tolerances = pair if own is None else None
        # What it changes has been said before the runs were traced; see `many.warn_of_starts`.
        start = known_start(system, self.ts)
        conditions = [*compiled.conditions, *traced_times(self.ts), *jump_conditions(system, self.ts)]
        legal = jnp.all(jnp.stack([jnp.array(True), *conditions]))
        assembly = None if start is None else start.assembly
        solver = method.choice.solver
        limits = audit_limits(system, pair[0], solver)
        return job_of(plan, jnp.asarray(theta), self.ts, assembly, legal, limits, own, in_machine_code(plan))

    def problem(self) -> LaneProblem:
        """What every lane integrates."""
        plan, method = self.plan, self.method
        assert plan is not None
        arrays, solver = eqx.partition(method.choice.solver, eqx.is_array)
        slack = None if method.derivative_rtol is None else method.derivative_rtol / method.rtol
        kind = JobKind(plan.structure, plan.scalar, solver, bool(method.by), method.watch, slack, plan.unknown)
        return kind.problem(self.ts, (arrays, self.shared_tolerances, method.max_steps))

    def trajectory(self, start: Job, outcome: LaneOutcome) -> Trajectory:
        """One run as a trajectory."""
        plan = self.plan
        assert plan is not None
        return Trajectory(
            ts=self.ts,
            ys=outcome.ys,
            system=plan.structure.system(start.numbers.theta),
            stats=statistics(outcome, stages_of(self.method.choice.solver), self.explanation),
            ended=outcome.status,
            t_reached=outcome.t_reached,
            y_reached=outcome.y_reached,
            assembly=start.assembly,
            choice=self.method.choice.reason,
            scalar=plan.scalar,
            asked=self._asked,
        )

    @property
    def _asked(self) -> Asked | None:
        method = self.method
        rtol, atol = method.rtol, method.atol
        if not (is_concrete(rtol) and is_concrete(atol)):
            return None
        return Asked(method.choice.solver, float(rtol), None if atol is None else float(atol), method.max_steps)
