"""The state of a run at any moment: integrated on from the sample before it, by the run's own method."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.errors import SceneError
from spherejax.model.system import System, flatten_by_factor
from spherejax.motion.integration.problem import Plan, RunMethod
from spherejax.motion.integration.spans import Jobs, over_spans
from spherejax.motion.integration.status import Status
from spherejax.motion.settings import RunSettings


def state_at(
    system: System,
    settings: RunSettings | None,
    scalar: bool | None,
    t0: float,
    y0: Float[np.ndarray, " size"],
    t: float,
) -> Float[np.ndarray, " size"]:
    """The flat state at time t [s] of a run that has the state y0 at time t0.

    Raises:
        SceneError: for a run that cannot be gone on with.
    """
    if settings is None:
        raise SceneError(
            "a moment between samples is integrated anew, which this run's method does not allow (its tolerances were "
            "traced, or a controller of its own judged them); add the time to ts"
        )
    structure, theta = flatten_by_factor(system)
    jobs = Jobs(
        jnp.asarray(theta)[None],
        jnp.asarray(y0)[None],
        jnp.zeros((1, 0, len(theta))),
        jnp.array([t0]),
        jnp.array([t - t0]),
        jnp.ones(1, bool),
    )
    plan, method = Plan(structure, (), scalar), RunMethod.of_settings(system, structure, settings)
    found = over_spans(plan, method, False, 1, jobs, jnp.array([0.0, 1.0]))
    if int(found.status[0]) != Status.SUCCEEDED:
        raise SceneError(f"the run could not be integrated on from its sample at {t0:.9g} s to {t:.9g} s")
    return np.asarray(found.ys[0, -1])
