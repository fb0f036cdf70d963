"""The energy balance of a run by part: what was put in, what is stored, and what was lost where."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from spherejax.foundations.rotation import rotation_matrix
from spherejax.foundations.types import Numeric
from spherejax.model.system import System, flatten_by_factor
from spherejax.motion.equations.observables import Observation
from spherejax.motion.results.observed import observation_of
from spherejax.motion.results.steps import SHARES, Steps
from spherejax.physics.bodies import GROUND
from spherejax.physics.state import unpack

ROUNDED_LOSS = 1e-8
"""Loss as a share of the largest energy of a motion below which it is rounding and the error of an integration at the
usual tolerance: an ideal joint "loses" -1e-8 mJ of 100 mJ."""

MOTION, WEIGHT = "kinetic energy", "weight"
"""Names of what is stored in no joint and no force element."""


_BASES = [Polynomial.fromroots([x for x in SHARES if x != node]) for node in SHARES]
_TO_INSTANTS = np.array(
    [[basis.integ()(end) / basis(node) for basis, node in zip(_BASES, SHARES, strict=True)] for end in (*SHARES, 1.0)]
)
"""Integrals of Lagrange's polynomials of the inner instants, from the beginning of a step of length one to each inner
instant and its end; the last row are Gauss and Legendre's weights."""


class EnergyByPart(NamedTuple):
    """Histories of energies by part since the start of a run [J], at five instants of each of its steps.

    Attributes:
        ts: the start, then four instants inside and the end of each step [s], shape (n,).
        put_in: by drivers and by force elements that may add energy, net: negative where they took more.
        stored: change of the energy in the motion, of the weight, and in joints and force elements.
        lost: in joints, and in force elements that only store and dissipate.
        unaccounted: put in, less stored, less lost: the errors of the integration and of the drift control.
    """

    ts: Float[np.ndarray, " n"]
    put_in: dict[str, np.ndarray]
    stored: dict[str, np.ndarray]
    lost: dict[str, np.ndarray]
    unaccounted: Float[np.ndarray, " n"]


def energy_by_part(system: System, steps: Steps, scalar: bool | None) -> EnergyByPart:
    """The balance, by Gauss and Legendre's rule for the powers in each step.

    Args:
        system: what was run.
        steps: of the run.
        scalar: whether the run was on scalar programs.

    For a part that puts the work W into the bodies and stores U:

        lost = -W - (U - U_0),    put in = W + (U - U_0)

    A resisting joint takes the power -(F.v + M.w), with its reaction on the second body, about the joint's point, and
    the motion of that body against the first; constraint forces drop out of it.
    """
    n, k = steps.inside.shape
    structure, theta = flatten_by_factor(system)
    theta = jnp.asarray(theta)
    # All instants in order: each step's inner ones, then its end.
    ts = np.concatenate([[steps.t0], np.concatenate([steps.inside, steps.ends[:, None]], 1).ravel()])
    in_order = np.concatenate([steps.at_inside, steps.at_ends[:, None]], 1).reshape(n * (k + 1), -1)
    at_all = np.concatenate([steps.y0[None], in_order])

    observed = observation_of(structure, scalar, theta, jnp.asarray(ts), jnp.asarray(at_all))
    seen: Observation = jax.tree.map(np.asarray, observed)

    def total(power: Numeric) -> np.ndarray:
        # Only inner instants are used: at the ends of a step powers may jump, by an impact or a sample.
        within = np.asarray(power)[1:].reshape(n, k + 1)[:, :k] @ _TO_INSTANTS.T * steps.lengths[:, None]
        before = np.concatenate([[0.0], np.cumsum(within[:, -1])])
        return np.concatenate([[0.0], (before[:-1, None] + within).ravel()])

    put_in = {name: total(power) for name, power in seen.driving_power.items()}
    stored = {MOTION: _change(seen.kinetic_energy)}
    in_forces = {name: results["potential_energy"] for name, results in seen.forces.items()}
    stored[WEIGHT] = _change(seen.potential_energy - sum(in_forces.values()))
    lost = {}
    for name in system.resisting_joints:
        change = _change(seen.elastic_energy[name])
        lost[name] = total(_absorbed(system, name, at_all, seen)) - change
        if np.any(change):
            stored[name] = change
    for name, element in system.forces.items():
        change, work = _change(in_forces[name]), total(seen.forces[name]["power"])
        if element.never_adds_energy:
            lost[name] = -work - change
        else:
            put_in[name] = work + change
        if np.any(change):
            stored[name] = change
    summed = [sum(histories.values(), np.zeros(len(ts))) for histories in (put_in, stored, lost)]
    return EnergyByPart(ts, put_in, stored, lost, summed[0] - summed[1] - summed[2])


def _absorbed(system: System, name: str, ys: np.ndarray, seen: Observation) -> np.ndarray:
    """Power that a joint takes from its two bodies [W], at many states."""
    joint, state = system.joints[name], unpack(system.layout, jnp.asarray(ys))
    names, rows = list(system.bodies), len(ys)
    position, velocity, turning = np.zeros((3, 2, rows, 3))
    arm = np.zeros((rows, 3))
    for side, body in enumerate(joint.bodies):
        place = np.asarray(joint.points[side])
        if body == GROUND:
            arm = np.broadcast_to(place, (rows, 3)) if side else arm
            continue
        i = names.index(body)
        position[side], velocity[side] = state.position[:, i], state.velocity[:, i]
        turning[side] = state.angular_velocity[:, i]
        if side:
            arm = np.asarray(jax.vmap(rotation_matrix)(jnp.asarray(state.quaternion[:, i]))) @ place
    point = position[1] + arm
    # The first body feels the opposite of the reaction at the same place, so its velocity is taken there, too.
    relative = velocity[1] + np.cross(turning[1], arm) - velocity[0] - np.cross(turning[0], point - position[0])
    force, moment = seen.reactions[name]
    return -np.sum(force * relative + moment * (turning[1] - turning[0]), axis=-1)


def _change(values) -> np.ndarray:
    values = np.asarray(values)
    return values - values[0]
