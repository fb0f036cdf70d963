"""Which integrator a scene gets when the user does not say."""

from typing import NamedTuple

import diffrax
import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.model.system import System
from spherejax.motion.solvers.rosenbrock import Rodas5P
from spherejax.physics.joints import Bushing, Lubricated
from spherejax.physics.laws import RadialElastomer, VectorElastomer

STIFF_RATE = 2e5
"""Fastest rate [1/s] that an explicit method still follows cheaply: its steps are then about 3.3 / rate, and a
simulated second costs 6e4 steps of 5 microseconds, about what a stiff method needs for the same motion."""


class Choice(NamedTuple):
    """A solver and the reason for it.

    Attributes:
        solver: a diffrax solver.
        reason: one sentence.
    """

    solver: diffrax.AbstractSolver
    reason: str


def choose_solver(system: System) -> Choice:
    """Choose the integrator by the stiffest effect that the scene calls for.

    A film damps at rates of 1e7 per second and more; a bushing at k b / m and with a frequency of sqrt(k / m), m being
    the lighter of the two bodies (the mobility at the joint is at least that of its mass). Numbers that are traced are
    not looked at: the choice then rests on the models alone.
    """
    for name in system.force_joints:
        model = system.spherical(name).model
        if isinstance(model, Lubricated):
            return Choice(Rodas5P(), f"Rodas5P: the film of joint {name!r} is stiff")
        rate = _bushing_rate(system, name, model) if isinstance(model, Bushing) else 0.0
        if rate > STIFF_RATE:
            return Choice(Rodas5P(), f"Rodas5P: the bushing of joint {name!r} relaxes at about {rate:.0e} per second")
    return Choice(diffrax.Dopri8(), "Dopri8: no effect of the scene is stiff")


def _bushing_rate(system: System, name: str, model: Bushing) -> float:
    joint = system.spherical(name)
    law = model.law
    masses = [system.bodies[body].mass for body in joint.bodies if body in system.bodies]
    if not isinstance(law, RadialElastomer | VectorElastomer):
        return 0.0
    if not all(is_concrete(value) for value in (law.stiffness, law.damping, *masses)):
        return 0.0
    mass = float(min(np.asarray(m) for m in masses))
    stiffness, damping = float(law.stiffness), float(law.damping)
    return max(stiffness * damping / mass, (stiffness / mass) ** 0.5)
