"""The numbers of the four-bar, read from spherejax's compiled system, so that both sides have the same equations."""

from typing import NamedTuple

import jax
import numpy as np

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.integration.problem import initial_state
from spherejax.motion.start.assembly import as_ideal, assemble_now
from spherejax.physics.joints.contact import stiffness_of
from spherejax.physics.laws.film import squeeze_coefficient

BODIES = ("coupler", "crank", "rocker")
"""The order of the state: 7 position coordinates a body, then 6 velocities a body."""

N_STATE = 39

# Where each number is in the flat vector that the hand-written equations take.
INVERSE_MASS, INERTIA, INVERSE_INERTIA, GRAVITY = 0, 3, 12, 21
CRANK_PIVOT, ROCKER_PIVOT = 24, 39  # each: ground point, place on the body, two ground directions, axis on the body
CRANK_PIN, COUPLER_CRANK_END, COUPLER_ROCKER_END, ROCKER_COUPLER_END = 54, 57, 60, 63
ALPHA, BETA = 66, 67
STIFFNESS, DAMPING = 68, 69  # bushing: k, b; contact: K, chi
CLEARANCE, SOCKET_RADIUS, FRICTION, THRESHOLD = 70, 71, 72, 73
FILM, WIDTH, OFFSET = 74, 75, 76
N_PARAMETERS = 77


class Problem(NamedTuple):
    """A run of the four-bar as numbers.

    Attributes:
        kind: "ideal", "bushing", "dry" or "lubricated".
        parameters: shape (77,).
        y0: consistent start, shape (39,).
    """

    kind: str
    parameters: np.ndarray
    y0: np.ndarray


def problem(model) -> Problem:
    """The numbers of the four-bar with a joint model."""
    system = compile_scene(sj.gallery.four_bar(model)).system
    assert tuple(system.bodies) == BODIES, "the hand-written equations know one order of the bodies"
    start = jax.tree.map(np.asarray, assemble_now(*flatten_system(as_ideal(system))))
    y0 = np.array(initial_state(system, start))[:N_STATE]
    p = np.zeros(N_PARAMETERS)
    for i, body in enumerate(system.bodies.values()):
        p[INVERSE_MASS + i] = 1 / float(body.mass)
        p[INERTIA + 3 * i : INERTIA + 3 * i + 3] = body.inertia
        p[INVERSE_INERTIA + 3 * i : INVERSE_INERTIA + 3 * i + 3] = 1 / np.asarray(body.inertia)
    p[GRAVITY : GRAVITY + 3] = system.gravity
    for at, name in ((CRANK_PIVOT, "crank_pivot"), (ROCKER_PIVOT, "rocker_pivot")):
        pivot = system.joints[name]
        across = [on_first for on_first, _ in pivot.right_angles]
        p[at : at + 15] = np.concatenate([*pivot.places, *across, pivot.axes[0]])
    for at, name in ((CRANK_PIN, "crank_coupler"), (COUPLER_ROCKER_END, "coupler_rocker")):
        joint = system.spherical(name)
        p[at : at + 6] = np.concatenate([joint.socket_place, joint.ball_place])
    p[ALPHA], p[BETA] = float(system.drift.alpha), float(system.drift.beta)
    kind = _fill_model(p, model)
    return Problem(kind, p, y0)


def _fill_model(p: np.ndarray, model) -> str:
    if isinstance(model, sj.Ideal):
        return "ideal"
    if isinstance(model, sj.Bushing):
        p[STIFFNESS], p[DAMPING] = model.law.stiffness, model.law.damping
        return "bushing"
    p[STIFFNESS] = float(stiffness_of(model.normal, model.surfaces))
    p[DAMPING] = float(model.normal.hysteresis_factor())
    p[CLEARANCE], p[SOCKET_RADIUS] = model.clearance, model.socket_radius
    p[THRESHOLD] = 1.0
    if model.friction is not None:
        p[FRICTION], p[THRESHOLD] = model.friction.mu, model.friction.v1
    if isinstance(model, sj.Dry):
        return "dry"
    if not isinstance(model.film, sj.laws.RadialFilm):
        raise TypeError("the hand-written equations have the paper's film alone: film=sj.laws.RadialFilm()")
    p[FILM] = float(squeeze_coefficient(model.viscosity, model.socket_radius, model.clearance))
    p[WIDTH], p[OFFSET] = model.e_h0, model.e_h1
    return "lubricated"
