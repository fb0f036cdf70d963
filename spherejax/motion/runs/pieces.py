"""A motion made piece by piece: who drives it may change numbers in between, and take it up from any state again."""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.model.system import System, compile_scene, flatten_system
from spherejax.motion.equations.programs import path_of
from spherejax.motion.integration.one_run import run_of
from spherejax.motion.integration.problem import Plan, RunInputs, RunMethod, initial_state
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.simulate import choice_for
from spherejax.motion.settings import DEFAULT_MAX_STEPS, RunSettings
from spherejax.motion.start.assembly import Assembly
from spherejax.motion.start.start_now import known_start


class PieceOutcome(NamedTuple):
    """What comes of a piece.

    Attributes:
        t: time reached [s].
        y: flat state there.
        diagnosis: why it did not reach its end; empty where it did.
    """

    t: float
    y: Float[np.ndarray, " size"]
    diagnosis: str


class Pieces:
    """A scene whose motion is made piece by piece.

    Each piece is integrated as `simulate` does it: by the same method, landing on contacts, audited. The memory of
    joints and the account of energy go on from piece to piece; the size of the first step does not.

    Attributes:
        changes: what the last start changed of the positions and velocities that the scene describes, in sentences.

    Args:
        scene_of: the scene from the numbers that may change; it is traced.
        values: these numbers.

    Other args:
        rtol, solver, max_steps: as in `simulate`; the latter of a piece.

    Raises:
        SceneError: for a scene that cannot be simulated.
    """

    def __init__(
        self,
        scene_of: Callable[[Any], Scene],
        values: Float[np.ndarray, " k"],
        *,
        rtol: float = 1e-8,
        solver: diffrax.AbstractSolver | None = None,
        max_steps: int = DEFAULT_MAX_STEPS,
    ):
        self.scene_of = scene_of
        self.changes: tuple[str, ...] = ()
        system = self.system_with(values)
        self._theta = jax.jit(self._traced)
        plan: list[Plan] = []
        jax.eval_shape(lambda values: self._traced(values, plan), jnp.asarray(values, jnp.float64))
        self.plan = plan[0]
        is_explicit_only = self.plan.scalar is False
        self.choice = (
            choice_for(system, rtol, solver, explicit_only=is_explicit_only)
            if solver is None
            else choice_for(None, rtol, solver)
        )
        settings = RunSettings(rtol, solver=self.choice.solver, max_steps=max_steps)
        self._method = RunMethod.of_settings(system, self.plan.structure, settings)

    def system_with(self, values: Float[np.ndarray, " k"]) -> System:
        """The system with other numbers, checked.

        Raises:
            SceneError: naming the number that is not legal.
        """
        return compile_scene(self.scene_of(np.asarray(values, np.float64))).system

    def start(self, t: float, values: Float[np.ndarray, " k"]) -> Float[np.ndarray, " size"]:
        """The flat state at the start, at time t [s].

        Raises:
            SceneError: for numbers that are not legal, and joints that cannot be closed.
        """
        system = self.system_with(values)
        start = known_start(system, np.array([t]))
        assert start is not None
        self.changes = start.changes
        return np.asarray(initial_state(system, start.assembly))

    def go_on(
        self, t: float, y: Float[np.ndarray, " size"], t_end: float, values: Float[np.ndarray, " k"]
    ) -> PieceOutcome:
        """The motion from a time and a state to another time, with these numbers all the while."""
        if not t_end > t:
            raise SceneError(f"a piece from t = {t:.9g} s to t = {t_end:.9g} s does not go on")
        theta, legal = self.theta_at(values)
        ts = jnp.asarray([t, t_end])
        here = _closed(y, self.plan.structure.system(theta).layout.n_bodies)
        outcome = run_of(self.plan, self._method, RunInputs(np.zeros(0), theta, ts, here, legal))
        run = Trajectory(
            ts=ts,
            ys=outcome.ys,
            system=self.plan.structure.system(theta),
            stats=outcome.stats,
            ended=outcome.status,
            t_reached=outcome.t_reached,
            y_reached=outcome.y_reached,
            assembly=here,
            choice=self.choice.reason,
            scalar=self.plan.scalar,
        )
        return PieceOutcome(float(outcome.t_reached), np.asarray(outcome.y_reached), run.diagnosis)

    def theta_at(self, values: Float[np.ndarray, " k"]) -> tuple[Any, Any]:
        """All numbers of the system, and whether they are legal."""
        return self._theta(jnp.asarray(values, jnp.float64))

    def _traced(self, values, plan: list[Plan] | None = None):
        compiled = compile_scene(self.scene_of(values))
        structure, theta = flatten_system(compiled.system)
        if plan is not None:
            # All numbers are known when a piece begins: it goes the road of a single run. The structure was found with
            # some of them traced, so that none of those is folded into the program.
            plan.append(Plan(structure, (), path_of(structure).scalar))
        legal = jnp.all(jnp.stack(compiled.conditions)) if compiled.conditions else jnp.array(True)
        return jnp.asarray(theta), legal


def _closed(y: Float[np.ndarray, " size"], n_bodies: int) -> Assembly:
    """A state in the middle of a motion, where there is nothing to assemble."""
    nothing = jnp.zeros(n_bodies)
    return Assembly(jnp.asarray(y), jnp.zeros(()), jnp.zeros(()), nothing, nothing, nothing)
