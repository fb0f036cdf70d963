"""Set-up of a batch: how each run of it starts, what is integrated, and the trajectory that its lane returns.

The scene of one run is traced for all; what depends on the run alone are numbers.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene, example_of, flatten_system, split
from spherejax.motion.equations.programs import path_of
from spherejax.motion.integration.compiling import in_machine_code
from spherejax.motion.integration.jobs import Job, JobKind, job_of, statistics, with_slopes
from spherejax.motion.integration.lanes import Block, LaneOutcome, LaneProblem
from spherejax.motion.integration.problem import Plan, RunMethod, audit_limits, stages_of
from spherejax.motion.integration.sensitivity_rows import scales_of
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.simulate import tolerances_of, traced_times
from spherejax.motion.settings import RunSettings
from spherejax.motion.start.jumps import jump_conditions
from spherejax.motion.start.start_now import known_start
from spherejax.motion.start.tolerances import controller_for


class BatchSettings(NamedTuple):
    """How the runs of a batch are integrated, and what is kept of them (static).

    Attributes:
        runs: settings of each run, with the solver for all.
        reason: why this solver.
        block: how wide the block of lanes is.
        watch: names of quantities whose largest magnitudes are kept.
        by: names of the parameters whose sensitivities are integrated as well.
    """

    runs: RunSettings
    reason: str
    block: Block
    watch: tuple[str, ...] = ()
    by: tuple[str, ...] = ()


class PreparedRuns:
    """What is known of all runs once one has been traced: the plan and the tolerances that they share."""

    def __init__(self, scene_of: Callable[[Any], Scene], settings: BatchSettings, ts):
        self.scene_of, self.settings, self.ts = scene_of, settings, ts
        self.plan: Plan | None = None
        self.method: RunMethod | None = None

    @property
    def contact_joints(self) -> tuple[str, ...]:
        """Names of the joints whose contacts are counted."""
        assert self.plan is not None
        return example_of(self.plan.structure).contact_joints

    def start(self, parameters) -> Job:
        """One run as a job, with its sensitivities as rows below the state where they are asked for."""
        by = self.settings.by
        if not by:
            return self.start_of_state(parameters)

        def of_values(values):
            return self.start_of_state({**parameters, **dict(zip(by, values, strict=True))})

        values = jnp.stack([parameters[name] for name in by])
        return with_slopes(of_values, values, jnp.diag(scales_of(values)))[0]

    def start_of_state(self, parameters) -> Job:
        """Build the scene of one run and assemble its start."""
        settings = self.settings.runs
        compiled = compile_scene(self.scene_of(parameters), track_work=settings.track_work)
        system = compiled.system
        structure, theta = flatten_system(system)
        _, unknown = split(system)
        self.plan = plan = Plan(structure, unknown, path_of(structure).scalar)
        tolerances = tolerances_of(system, settings.rtol, settings.atol)
        self.explanation = f"{self.settings.reason}; {tolerances.description}; first step by trial (Hairer)"
        # Solvers of lanes solve their stages themselves: no root finder has to converge.
        controller, factor = controller_for(structure, tolerances.rtol, tolerances.atol), settings.derivative_rtol
        factor = None if factor is None else factor / settings.rtol
        self.method = method = RunMethod.of(
            structure, settings.solver, controller, settings.max_steps, tangent_tolerance_factor=factor
        )
        # What it changes has been said before the runs were traced; see `many.warn_of_starts`.
        start = known_start(system, self.ts)
        conditions = [*compiled.conditions, *traced_times(self.ts), *jump_conditions(system, self.ts)]
        legal = jnp.all(jnp.stack([jnp.array(True), *conditions]))
        assembly = None if start is None else start.assembly
        limits, own = audit_limits(structure, theta, tolerances.rtol, settings.solver), method.own_tolerances
        return job_of(plan, jnp.asarray(theta), self.ts, assembly, legal, limits, own, in_machine_code(plan))

    def problem(self) -> LaneProblem:
        """What every lane integrates."""
        plan, method, settings = self.plan, self.method, self.settings
        assert plan is not None
        assert method is not None
        kind = JobKind.of(
            plan,
            method,
            with_rows=bool(settings.by),
            watch=settings.watch,
            tangent_tolerance_factor=method.tangent_tolerance_factor,
            moving=plan.unknown,
        )
        return kind.problem(self.ts, method.shared)

    def trajectory(self, start: Job, outcome: LaneOutcome) -> Trajectory:
        """One run as a trajectory."""
        plan = self.plan
        assert plan is not None
        return Trajectory(
            ts=self.ts,
            ys=outcome.ys,
            system=plan.structure.system(start.numbers.theta),
            stats=statistics(outcome, stages_of(self.settings.runs.solver), self.explanation),
            ended=outcome.status,
            t_reached=outcome.t_reached,
            y_reached=outcome.y_reached,
            assembly=start.assembly,
            choice=self.settings.reason,
            scalar=plan.scalar,
            settings=self.settings.runs.of_run(self.settings.runs.solver),
        )
