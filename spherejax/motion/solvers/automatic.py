"""Which integrator a scene gets when the user does not say: the cheaper one by an estimate of what both would cost."""

from functools import lru_cache
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System, flatten_system
from spherejax.motion.body_motions import body_motions
from spherejax.motion.constraints import constraint_set, inverse_masses, solve_augmented
from spherejax.motion.loads import BodyVectors, applied_wrenches
from spherejax.motion.programs import program_for
from spherejax.motion.solvers.rosenbrock import Rodas5P, Ros34PW2
from spherejax.physics.joints import Bushing, Lubricated, PlacedSpherical
from spherejax.physics.state import VELOCITY_SIZE, unpack

STABILITY_BOUND = 6.0
"""Dopri8 is stable for steps of up to about this over the fastest rate of decay."""

LOOSE_RTOL = 1e-6
"""From this tolerance up, a W-method of order 3 with its cheap steps beats Rodas5P."""

USUAL_ECCENTRICITY_RATIO = 0.5
"""Where in its clearance a lubricated ball is looked at."""

SMALL_DEFLECTION = 1e-6
"""Deflection [m] at which an elastomer is looked at."""


class StiffMethod(NamedTuple):
    """A stiff method and what it costs, measured on the four-bar.

    Attributes:
        solver: the method.
        price: of a step, in steps of Dopri8.
        steps_per_second: steps for a second of motion at rtol 1e-6.
        steps_per_decade: factor of these for each digit more.
    """

    solver: diffrax.AbstractSolver
    price: float
    steps_per_second: float
    steps_per_decade: float

    def cost(self, rtol: float) -> float:
        """Cost of a second of motion, in steps of Dopri8."""
        return self.price * self.steps_per_second * self.steps_per_decade ** np.log10(1e-6 / rtol)


LOOSE = StiffMethod(Ros34PW2(), 0.65, 3200.0, 2.0)
TIGHT = StiffMethod(Rodas5P(), 2.25, 1800.0, 1.7)


class Choice(NamedTuple):
    """A solver and the reason for it.

    Attributes:
        solver: a diffrax solver.
        reason: one sentence.
    """

    solver: diffrax.AbstractSolver
    reason: str


def choose_solver(system: System, rtol=1e-8, *, explicit_only: bool = False) -> Choice:
    """Choose between an explicit method (Dopri8) and a stiff one (Ros34PW2, Rodas5P) by what they would cost.

    An explicit method needs at least `rate / STABILITY_BOUND` steps a second, `rate` being the fastest with which a
    film or an elastomer acts on the bodies that it joins; a stiff one needs the steps of its accuracy. Contacts are
    left to the explicit method: they are short, and landed on. Numbers that are traced are not looked at: the choice
    then rests on the models alone.

    Args:
        system: the system.
        rtol: relative tolerance of the run; 1e-8 is assumed when it is traced.

    Other args:
        explicit_only: the system is too large for a stiff method: on the array path its linear systems are dense.
    """
    stiff_models = [name for name in system.force_joints if _may_be_stiff(system.joints[name])]
    if not stiff_models:
        return Choice(diffrax.Dopri8(), "Dopri8: no joint has a film or an elastomer")
    if explicit_only:
        reason = (
            f"Dopri8: joint {stiff_models[0]!r} may be stiff, but the linear systems of a stiff method would be dense"
        )
        return Choice(diffrax.Dopri8(), reason)
    known_rtol = float(rtol) if is_concrete(rtol) else 1e-8
    stiff = stiff_method(known_rtol).solver
    name_of_stiff = type(stiff).__name__
    structure, theta = flatten_system(system)
    if not is_concrete(theta):
        films = [name for name in stiff_models if isinstance(system.spherical(name).model, Lubricated)]
        if films:
            return Choice(stiff, f"{name_of_stiff}: joint {films[0]!r} has a film; its numbers are traced")
        return Choice(diffrax.Dopri8(), f"Dopri8: joint {stiff_models[0]!r} has an elastomer; its numbers are traced")
    rates = dict(zip(system.force_joints, _rates_now(structure, theta.tobytes()), strict=True))
    name = max(stiff_models, key=lambda joint: rates[joint])
    limit = explicit_rate_limit(known_rtol)
    what = f"joint {name!r} acts at about {rates[name]:.1e} per second"
    if rates[name] > limit:
        reason = f"{name_of_stiff}: {what}, beyond {limit:.1e}, where explicit steps cost more at this rtol"
        return Choice(stiff, reason)
    return Choice(diffrax.Dopri8(), f"Dopri8: {what}, below {limit:.1e}, where stiff steps cost more at this rtol")


def stiff_method(rtol: float) -> StiffMethod:
    """The cheaper stiff method at a tolerance."""
    return LOOSE if rtol >= LOOSE_RTOL else TIGHT


def explicit_rate_limit(rtol: float) -> float:
    """The rate [1/s] at which the explicit and the stiff method cost the same."""
    return float(STABILITY_BOUND * stiff_method(rtol).cost(rtol))


def _may_be_stiff(joint) -> bool:
    return isinstance(joint, PlacedSpherical) and isinstance(joint.model, Bushing | Lubricated)


@lru_cache(maxsize=1024)
def _rates_now(structure: Structure, numbers: bytes) -> np.ndarray:
    theta = np.frombuffer(numbers)
    system = structure.system(theta)
    places = [[*np.asarray(body.position), *np.asarray(body.quaternion)] for body in system.bodies.values()]
    y = np.zeros(system.layout.size)
    y[: system.layout.n_position] = np.concatenate(places)
    found = program_for(joint_actions, structure).compute(theta, 0.0, y)
    decay, frequency = (np.max(np.abs(np.linalg.eigvals(matrices)), axis=1) for matrices in found)
    return np.nan_to_num(np.maximum(decay, np.sqrt(frequency)), nan=np.inf)


def joint_actions(system: System, t: Scalar, y: Float[Array, " size"]) -> tuple[Float[Array, "n 3 3"], ...]:
    """How each force joint acts on the relative motion of ball and socket at the start.

    Returns:
        m^-1 C [1/s] and m^-1 K [1/s^2] of each joint, with C = -df/d(e_dot), K = -df/de, and m^-1 the relative
        acceleration of ball and socket for a unit force between them, under the constraints. The ball is looked at
        where the weights of the bodies would press it.
    """
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    constraints, masses = constraint_set(system, t, motions), inverse_masses(system, motions)
    weights = applied_wrenches(system, t, motions, None)
    falling = _by_name(system, solve_augmented(constraints, masses, weights, constraints.bias).accelerations)
    mobilities = _mobilities(system, motions, constraints, masses)
    decays, squares = [], []
    for name in system.force_joints:
        joint = system.spherical(name)
        motion = joint.relative_motion(motions)
        separation = _relative_acceleration(joint, motions, falling)
        distance = USUAL_ECCENTRICITY_RATIO * getattr(joint.model, "clearance", SMALL_DEFLECTION)
        place = distance * (separation + SMALLEST * jnp.ones(3)) / (safe_norm(separation) + SMALLEST)

        memory = state.memory[system.memory_of(name)]

        def force(e, rate, joint=joint, motion=motion, memory=memory):
            return joint.model.respond(motion._replace(eccentricity=e, eccentricity_rate=rate), memory).force

        stiffness, damping = jax.jacfwd(force, (0, 1))(place, jnp.zeros(3))
        mobility = mobilities[name]
        decays.append(mobility @ damping)
        squares.append(mobility @ stiffness)
    return jnp.stack(decays), jnp.stack(squares)


SMALLEST = 1e-12


def _mobilities(system: System, motions, constraints, masses) -> dict[str, Float[Array, "3 3"]]:
    """Relative accelerations of ball and socket of each force joint for unit forces along the axes [1/kg]."""
    pairs = []
    for name in system.force_joints:
        joint = system.spherical(name)
        for unit in jnp.eye(3):
            loads = {body: jnp.zeros(VELOCITY_SIZE) for body in system.bodies}
            for body, center, force in zip(joint.bodies, joint.centers(motions), (-unit, unit), strict=True):
                if body in loads:
                    loads[body] = jnp.concatenate([force, jnp.cross(center.arm, force)])
            pairs.append(jnp.stack(list(loads.values())))
    none = jnp.zeros_like(constraints.bias)
    moved = jax.vmap(lambda load: solve_augmented(constraints, masses, load, none).accelerations)(jnp.stack(pairs))
    found = {}
    for i, name in enumerate(system.force_joints):
        joint = system.spherical(name)
        columns = [_relative_acceleration(joint, motions, _by_name(system, moved[3 * i + k])) for k in range(3)]
        found[name] = jnp.stack(columns, 1)
    return found


def _by_name(system: System, accelerations: BodyVectors) -> dict[str, Float[Array, "6"]]:
    return {name: accelerations[i] for i, name in enumerate(system.bodies)}


def _relative_acceleration(joint: PlacedSpherical, motions, accelerations) -> Float[Array, "3"]:
    """Acceleration of the ball's center against the socket's, for bodies at rest [m/s^2]."""
    total = jnp.zeros(3)
    for body, center, sign in zip(joint.bodies, joint.centers(motions), (-1.0, 1.0), strict=True):
        if body in accelerations:
            a = accelerations[body]
            total = total + sign * (a[:3] + jnp.cross(a[3:], center.arm))
    return total
