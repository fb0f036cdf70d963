"""Which integrator a scene gets when the user does not say: the cheaper one by an estimate of what both would cost."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import diffrax
import numpy as np

from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.checks import is_concrete
from spherejax.model.system import Structure, System, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.solvers.force_rates import force_rates
from spherejax.motion.solvers.friction_rates import friction_rates
from spherejax.motion.solvers.joint_rates import rates_in_clearance, rates_under_load
from spherejax.motion.solvers.rosenbrock import Rodas5P, Ros34PW2
from spherejax.motion.start.tolerances import time_scale

STABILITY_BOUND = 6.0
"""Dopri8 is stable for steps of up to about this over the fastest rate of decay."""

FOUR_BAR_TIME = 0.105
"""Time scale [s] of the mechanism on which the stiff methods' steps were counted; see `tolerances.time_scale`."""

LOOSE_RTOL = 1e-6
"""From this tolerance up, a W-method of order 3 with its cheap steps beats Rodas5P."""


MOST_FOR_BOTH = 5_000
"""Scalar operations of a right-hand side up to which an explicit and a stiff method are compiled where numbers that
decide are hidden by `jax.jit`. The four-bar's 2,000 take 16 s of processor time with both, 6 s with Dopri8 alone."""


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


STEPS_WITH_FRICTION = 200.0
"""Steps within the mechanism's own time (`tolerances.time_scale`) up to which an explicit method follows friction in
ideal joints. Rodas5P makes some 40 of them on pendulums and chains with bristles at rtol 1e-8, where the explicit
method makes 1,600; the rest is what it loses elsewhere, in derivatives and the account of the energy."""


class AtStart(NamedTuple):
    """Another method, for a run whose numbers are seen when it starts.

    Attributes:
        solver: a diffrax solver.
        limit: it is taken where a joint acts faster than this [1/s].
    """

    solver: diffrax.AbstractSolver
    limit: float


class SolverChoice(NamedTuple):
    """A solver and the reason for it.

    Attributes:
        solver: a diffrax solver.
        reason: one sentence.
        at_start: what replaces it when a run starts with numbers that call for it; None where all is decided.
    """

    solver: diffrax.AbstractSolver
    reason: str
    at_start: AtStart | None = None


def choose_solver(system: System, rtol=1e-8, *, explicit_only: bool = False) -> SolverChoice:
    """Choose between an explicit method (Dopri8) and a stiff one (Ros34PW2, Rodas5P) by what they would cost.

    An explicit method needs at least `rate / STABILITY_BOUND` steps a second, `rate` being the fastest with which a
    joint acts on the bodies that it joins (a film, an elastomer, or the friction of a contact that lasts under load),
    or with which force elements, or friction in ideal joints, act at the start. A stiff method needs the steps of its
    accuracy. Contacts and stops that only come and go are left to the explicit method: they are short, and landed on or
    passed.

    Of numbers that are traced by `jax.jvp`, `jax.grad` or `jax.vmap` the values behind them are looked at; of lanes the
    first, the last and two in between, and the stiffest decides. `jax.jit` hides numbers: then the choice rests on the
    models alone, and where a joint has an elastomer (in a scene of less than `MOST_FOR_BOTH` operations) both methods
    are compiled and the run takes one when it starts; its derivatives are taken by the explicit one.

    Args:
        system: the system.
        rtol: relative tolerance of the run; 1e-8 is assumed when it is traced.

    Other args:
        explicit_only: the system is too large for a stiff method: on the array path its linear systems are dense.
    """
    if explicit_only:
        return SolverChoice(
            diffrax.Dopri8(), "Dopri8: the linear systems of a stiff method would be dense and too large"
        )
    known_rtol = max(map(float, known_behind(rtol)), default=1e-8)
    choices = [_choice(known, known_rtol) for known in known_behind(system) or [system]]
    return stiffest(choices)


def stiffest(choices: Sequence[SolverChoice]) -> SolverChoice:
    """The choice for several runs that are to be made by one method: a stiff one if any of them asks for it."""
    stiff = [choice for choice in choices if not isinstance(choice.solver, diffrax.AbstractERK)]
    return (stiff or choices)[0]


def _choice(system: System, known_rtol: float) -> SolverChoice:
    by_joints = _choice_by_joints(system, known_rtol)
    if system.friction_joints and isinstance(by_joints.solver, diffrax.Dopri8):
        by_friction = _choice_by_friction(system)
        if not isinstance(by_friction.solver, diffrax.Dopri8):
            return by_friction
        usual = "no joint has a film, an elastomer or friction"
        said = "" if by_joints.reason.endswith(usual) else f"; {by_joints.reason}"
        by_joints = by_joints._replace(reason=f"{by_friction.reason}{said}")
    if not system.forces:
        return by_joints
    by_forces = _choice_by_forces(system, known_rtol)
    if not isinstance(by_forces.solver, diffrax.Dopri8):
        return by_forces
    if system.force_states:
        by_memory = _choice_by_memory(system, known_rtol)
        if not isinstance(by_memory.solver, diffrax.Dopri8):
            return by_memory
        by_forces = SolverChoice(by_forces.solver, f"{by_forces.reason}; {by_memory.reason}")
    return by_joints._replace(reason=f"{by_joints.reason}; {by_forces.reason}")


def _choice_by_joints(system: System, known_rtol: float) -> SolverChoice:
    looked_at = [name for name in system.force_joints if _may_be_stiff(system.spherical(name).model)]
    if not looked_at:
        return SolverChoice(diffrax.Dopri8(), "Dopri8: no joint has a film, an elastomer or friction")
    stiff = stiff_method(known_rtol).solver
    name_of_stiff = type(stiff).__name__
    structure, theta = flatten_system(system)
    if not is_concrete(theta):
        resistance = {name: system.spherical(name).model.medium for name in looked_at}
        return _choice_by_models(resistance, known_rtol, may_have_both=_is_small(structure))
    fastest = _fastest(system, structure, theta, known_rtol)
    if fastest.per_second == 0:
        return SolverChoice(diffrax.Dopri8(), "Dopri8: no joint's friction is stiffer than its contact")
    limit = fastest.limit(known_rtol)
    what = f"joint {fastest.joint!r} {fastest.how} at about {fastest.per_second:.1e} per second"
    if fastest.per_second > limit:
        reason = f"{name_of_stiff}: {what}, beyond {limit:.1e}, where explicit steps cost more at this rtol"
        return SolverChoice(stiff, reason)
    return SolverChoice(
        diffrax.Dopri8(), f"Dopri8: {what}, below {limit:.1e}, where stiff steps cost more at this rtol"
    )


def _is_small(structure: Structure) -> bool:
    scalar = program_for(state_rate, structure).scalar
    return scalar is not None and scalar.n_operations <= MOST_FOR_BOTH


def _choice_by_models(resistance: dict[str, Any], rtol: float, *, may_have_both: bool) -> SolverChoice:
    """The choice for numbers that nobody sees before the run; what resists in each joint, None for friction alone."""
    fast = [name for name, by in resistance.items() if by is not None and by.is_usually_fast]
    filled = [name for name, by in resistance.items() if by is not None]
    name = (fast or filled or list(resistance))[0]
    by = resistance[name]
    said = f"joint {name!r} has {'friction' if by is None else by.value}; its numbers are traced"
    if fast:
        stiff = stiff_method(rtol).solver
        return SolverChoice(stiff, f"{type(stiff).__name__}: {said}")
    if not (filled and may_have_both):
        return SolverChoice(diffrax.Dopri8(), f"Dopri8: {said}")
    # The W-method at all tolerances: it compiles in twice the time of the explicit method, Rodas5P in four times.
    limit = float(STABILITY_BOUND * LOOSE.cost(rtol))
    stiff = type(LOOSE.solver).__name__
    said = f"{said}, and decide when the run starts: {stiff} where it acts faster than {limit:.1e} per second"
    return SolverChoice(diffrax.Dopri8(), f"Dopri8 or {stiff}: {said}", AtStart(LOOSE.solver, limit))


def _choice_by_forces(system: System, rtol: float) -> SolverChoice:
    """Rodas5P where force elements are too fast for Dopri8: the W-method leaves them out of its Jacobian."""
    structure, theta = flatten_system(system)
    if not is_concrete(theta):
        return SolverChoice(diffrax.Dopri8(), "numbers of the scene are traced, and force elements not looked at")
    limit = STABILITY_BOUND * TIGHT.cost(rtol) * FOUR_BAR_TIME / float(time_scale(system))
    # Constraints only slow things down: with them only what is too fast without them is looked at.
    rate = force_rates(system, structure, np.asarray(theta), constrained=False).fastest
    if rate > limit:
        rate = force_rates(system, structure, np.asarray(theta)).fastest
    what = f"force elements act at about {rate:.1e} per second or slower"
    if rate > limit:
        return SolverChoice(
            TIGHT.solver, f"Rodas5P: {what}, beyond {limit:.1e}, where explicit steps cost more at this rtol"
        )
    return SolverChoice(diffrax.Dopri8(), f"{what}, below {limit:.1e}")


def _choice_by_memory(system: System, rtol: float) -> SolverChoice:
    """Rodas5P where states of force elements are too fast for Dopri8, such as a controller's filter."""
    structure, theta = flatten_system(system)
    if not is_concrete(theta):
        return SolverChoice(diffrax.Dopri8(), "nor what they remember")
    limit = STABILITY_BOUND * TIGHT.cost(rtol) * FOUR_BAR_TIME / float(time_scale(system))
    rate = friction_rates(system, structure, np.asarray(theta)).fastest
    what = f"what force elements remember changes at about {rate:.1e} per second"
    if rate > limit:
        return SolverChoice(
            TIGHT.solver, f"Rodas5P: {what}, beyond {limit:.1e}, where explicit steps cost more at this rtol"
        )
    return SolverChoice(diffrax.Dopri8(), f"{what}, below {limit:.1e}")


def _choice_by_friction(system: System) -> SolverChoice:
    """Rodas5P where friction in ideal joints is too fast for Dopri8: the W-method leaves it out of its Jacobian."""
    structure, theta = flatten_system(system)
    if not is_concrete(theta):
        return SolverChoice(diffrax.Dopri8(), "Dopri8: friction in ideal joints; numbers are traced")
    limit = STABILITY_BOUND * TIGHT.price * STEPS_WITH_FRICTION / float(time_scale(system))
    rate = friction_rates(system, structure, np.asarray(theta)).fastest
    what = f"friction in ideal joints acts at about {rate:.1e} per second"
    if rate > limit:
        return SolverChoice(TIGHT.solver, f"Rodas5P: {what}, beyond {limit:.1e}, where explicit steps cost more")
    return SolverChoice(diffrax.Dopri8(), f"Dopri8: {what}, below {limit:.1e}, where stiff steps cost more")


class _Rate(NamedTuple):
    """How fast a joint acts, and the time scale of the motion that a stiff method would have to follow then."""

    joint: str
    how: str
    per_second: float
    time: float

    def limit(self, rtol: float) -> float:
        return explicit_rate_limit(rtol, self.time)


def _fastest(system: System, structure: Structure, theta, rtol: float) -> _Rate:
    """The rate that decides.

    A ball that floats in a film or an elastomer vibrates as it does on any mechanism; one that is held to its socket by
    friction or a film moves as slowly as the mechanism does.
    """
    models = {name: system.spherical(name).model for name in system.force_joints}
    found = []
    if any(model.medium is not None for model in models.values()):
        floating = rates_in_clearance(structure, theta)
        found += [
            _Rate(name, "acts", float(rate), FOUR_BAR_TIME)
            for (name, model), rate in zip(models.items(), floating, strict=True)
            if model.medium is not None
        ]
    # What acts too fast in the clearance need not be looked at under load: of a film that takes a second.
    if not any(rate.per_second > rate.limit(rtol) for rate in found):
        found += _rates_under_load(system, structure, theta, models)
    return max(found, key=lambda rate: rate.per_second / rate.limit(rtol))


def _rates_under_load(system: System, structure: Structure, theta, models: dict[str, Any]) -> list[_Rate]:
    if not any(model.has_surfaces for model in models.values()):
        return []
    time = float(time_scale(system))
    pressed = rates_under_load(structure, theta, patience=time)
    return [
        _Rate(name, "resists under load", float(rate), time)
        for name, rate in zip(models, pressed, strict=True)
        if models[name].has_surfaces
    ]


def stiff_method(rtol: float) -> StiffMethod:
    """The cheaper stiff method at a tolerance."""
    return LOOSE if rtol >= LOOSE_RTOL else TIGHT


def explicit_rate_limit(rtol: float, time: float = FOUR_BAR_TIME) -> float:
    """The rate [1/s] at which the explicit and the stiff method cost the same, in a scene with this time scale [s]."""
    return float(STABILITY_BOUND * stiff_method(rtol).cost(rtol) * FOUR_BAR_TIME / time)


def _may_be_stiff(model) -> bool:
    return model.medium is not None or getattr(model, "friction", None) is not None
