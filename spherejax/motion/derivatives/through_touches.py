"""Where derivatives of runs are refused, or doubted, because of how a contact or a stop begins to press.

* A force that jumps at the touch (a spring function with 300 N at a depth of zero) moves the velocity by another amount
  where the instant of the touch moves: the sensitivities jump there. They are integrated as if the force were
  continuous, and a derivative that is -1 came out as -159. To differentiate such a run is an error.
* A stiffness that changes at an unbounded rate where contact begins (an exponent of 1.05) is differentiated by
  Rosenbrock methods with errors of 1e-6 to 1e-4, which no tolerance makes smaller. They are given, with a warning.

Values have neither fault.
"""

import warnings
from collections.abc import Iterable

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.errors import SceneError
from spherejax.model.system import System
from spherejax.motion.equations.contacts import abrupt_contacts
from spherejax.motion.integration.status import SimulationWarning
from spherejax.motion.solvers.traits import is_explicit
from spherejax.program_cache import disk_cache

UNSURE_BY_ROSENBROCK = (
    "derivatives by {method} are not sure through {names}: the stiffness of the contact may change at an unbounded "
    "rate where it begins (an exponent between 1 and 1.4, or one that is traced; the laws of cylinders), and errors of "
    "1e-6 to 1e-4 were seen, which do not fall with rtol, or steps that shrink to nothing. Take an explicit method, "
    "whose derivatives are right to about 1e-6 there: solver=diffrax.Dopri8()"
)


def warn_of_rosenbrock(names: Iterable[str], solver: diffrax.AbstractSolver, stacklevel: int = 2) -> None:
    """Give a `SimulationWarning` where a method that is not explicit differentiates a run with abrupt contacts.

    Args:
        names: of these contacts; see `abrupt_contacts`.
        solver: the method.
        stacklevel: as of `warnings.warn`, from the caller on.
    """
    names = tuple(names)
    if names and not is_explicit(solver):
        disk_cache.note_warning()  # where it is traced: who loads that program from disk would not be warned
        said = UNSURE_BY_ROSENBROCK.format(method=type(solver).__name__, names=" and ".join(map(repr, names)))
        warnings.warn(said, SimulationWarning, stacklevel=stacklevel + 1)


def check_derivatives(system: System, solver: diffrax.AbstractSolver) -> None:
    """Refuse to differentiate runs of a system, or doubt it, as far as its numbers are known.

    Args:
        system: the system.
        solver: the method that integrates the sensitivities.

    Raises:
        SceneError: for a force that jumps at its touch.

    Warns:
        SimulationWarning: for a method that is not explicit and abrupt contacts.
    """
    any_jump(system)
    warn_of_rosenbrock(abrupt_contacts(system), solver, 3)


def any_jump(system: System) -> Bool[Array, ""] | None:
    """Whether a force jumps at its touch whose numbers are hidden by `jax.jit`; None where all are known.

    Raises:
        SceneError: for one that is known to jump.
    """
    hidden = []
    for name in system.touching_forces:
        force = system.forces[name].force_at_touch
        if force is None:
            continue
        seen = known_behind(force)
        at_touch = float(np.max([np.max(np.asarray(value)) for value in seen], initial=0.0))
        if at_touch > 0:
            raise SceneError(_jump_in_words(name, at_touch))
        if not seen:
            hidden.append(force > 0)
    return jnp.any(jnp.stack(hidden)) if hidden else None


def _jump_in_words(name: str, force: float) -> str:
    return (
        f"derivatives are not right through force {name!r}: its spring function gives {force:.6g} (N or N m) at a "
        "depth of zero, so that the force jumps where it touches, and the derivatives with it. Let it grow from zero "
        "within a small depth, e.g. spring=lambda d: 300.0 * jnp.tanh(d / 1e-6) + 1e6 * d, or take differences of runs"
    )
