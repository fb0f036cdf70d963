"""The state about which a mechanism is linearized: of a scene at its start or at rest, or of a run at any moment."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import shape_of
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, compile_scene, flatten_system
from spherejax.motion.integration.problem import initial_state
from spherejax.motion.integration.state_at import state_at
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.start.equilibrium import equilibrium
from spherejax.motion.start.start_now import start_now
from spherejax.studies.linear.tangent import TangentEquations

SAME_TIME = 1e-9
"""A sample is meant by a time that differs from its own by less than this share of the run."""


class OperatingPoint(NamedTuple):
    """A state of a system, and what it comes from.

    Attributes:
        whole: the scene, or the system of a run: where numbers are found by name.
        system: the system.
        structure, theta: of the system.
        t: time [s].
        y: flat state.
        words: what state it is.
        origin: "start", "rest" or "run": how the state follows numbers.
    """

    whole: Scene | System
    system: System
    structure: Structure
    theta: Float[np.ndarray, " p"]
    t: float
    y: Float[np.ndarray, " size"]
    words: str
    origin: str

    @property
    def equations(self) -> TangentEquations:
        """The equations of motion about it."""
        return TangentEquations(self.structure, self.theta, self.t, self.y)


def asked_of(what: Scene | Trajectory, at: str | float) -> tuple[Scene | System, System]:
    """Where numbers are found by name, and the system, before a start or a rest position is looked for.

    Raises:
        SceneError: for something that is no scene or run, a moment that there is not, or traced numbers.
    """
    if isinstance(what, Trajectory):
        if not is_concrete(what.ys) or np.ndim(what.ys) != 2:
            raise SceneError(
                "linearize takes a single run outside of jit, vmap and grad; take one lane of the batch first"
            )
        _sample(what, at)
        return what.system, what.system
    if not isinstance(what, Scene):
        raise SceneError(f"linearize: {type(what).__name__} is no scene and no run; give a Scene or a Trajectory")
    if not isinstance(at, str) or at not in ("start", "rest"):
        raise SceneError(
            f"linearize: at={at!r} is no state of a scene; it is 'start' or 'rest'. For a moment of its motion give "
            "the run: sj.linearize(sj.simulate(scene, ts), at=0.1)"
        )
    system = compile_scene(what).system
    if not is_concrete(flatten_system(system)[1]):
        raise SceneError("linearize looks at numbers; call it outside of jit, vmap and grad")
    return what, system


def point_of(what: Scene | Trajectory, at: str | float, t: float) -> OperatingPoint:
    """The state that is asked for, of what `asked_of` has found to be right."""
    if isinstance(what, Trajectory):
        return _of_run(what, at)
    scene = equilibrium(what, t=t).scene if at == "rest" else what
    system = compile_scene(scene).system
    structure, theta = flatten_system(system)
    assembly = start_now(system, np.array([t]), stacklevel=4)
    assert assembly is not None
    y = np.asarray(initial_state(system, jax.tree.map(jnp.asarray, assembly), t))
    words = "at rest" if at == "rest" else "about the start"
    return OperatingPoint(what, system, structure, np.asarray(theta), t, y, words, str(at))


def _of_run(run: Trajectory, at: str | float) -> OperatingPoint:
    i, wanted = _sample(run, at)
    t, y, system = float(run.ts[i]), np.asarray(run.ys[i]), run.system
    words = f"of the run at {t:.6g} s"
    if wanted is not None:
        y = state_at(system, run.settings, run.scalar, t, y, wanted)
        t, words = wanted, f"of the run at {wanted:.6g} s (integrated on from its sample at {t:.6g} s)"
    structure, theta = flatten_system(system)
    return OperatingPoint(system, system, structure, np.asarray(theta), t, y, words, "run")


def _sample(run: Trajectory, at: str | float) -> tuple[int, float | None]:
    """The sample of a run that is asked for; or the one before a moment between samples, and that moment."""
    ts, ys = np.asarray(run.ts), np.asarray(run.ys)
    if (isinstance(at, str) and at != "start") or (not isinstance(at, str) and shape_of(at) != ()):
        raise SceneError(f"linearize: at={at!r} is no moment of a run; give a time [s], or 'start'")
    wanted = float(ts[0]) if isinstance(at, str) else float(at)
    i = int(np.argmin(np.abs(ts - wanted)))
    is_sample = abs(ts[i] - wanted) <= SAME_TIME * max(abs(ts[-1]), abs(ts[0]))
    if not is_sample:
        if not ts[0] < wanted < ts[-1]:
            raise SceneError(f"linearize: at = {wanted:.9g} s is not within the run, {ts[0]:.9g} s to {ts[-1]:.9g} s")
        i = int(np.searchsorted(ts, wanted)) - 1
    last = i if is_sample else i + 1
    if not np.all(np.isfinite(ys[last])):
        raise SceneError(f"linearize: the run did not reach {wanted:.9g} s: {run.diagnosis}")
    return i, None if is_sample else wanted
