"""Which integrator a scene gets when the user does not say: the cheaper one by an estimate of what both would cost."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import numpy as np

from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.checks import called, is_concrete
from spherejax.model.system import Structure, System, example_of, flatten_system, is_own
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.solvers.force_rates import force_rates
from spherejax.motion.solvers.friction_rates import friction_rates
from spherejax.motion.solvers.implicit import inexact_systems_of, systems_of
from spherejax.motion.solvers.joint_rates import rates_in_clearance, rates_under_load
from spherejax.motion.solvers.linearization import sizes_of
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


ARRAY_ELIMINATION = 0.1
"""Price of a step of Rodas5P, in steps of Dopri8, times operations of the right-hand side over the cube of the unknowns
of its linear systems, where these are too many for a scalar program and solved as dense arrays. Measured on a Stewart
platform of 13 bodies (162 unknowns, 16,600 operations) on one core: 2.6 to 3.3 ms a step, 23 to 26 of Dopri8. With two
cores, on which the dense solver waits, a step takes 9 ms of processor time."""


NOTHING_IN_JOINTS = "Dopri8: no joint has a film, an elastomer or friction"


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
        excess: of a stiff method, by how many times what asks for it is faster than explicit steps pay for.
    """

    solver: diffrax.AbstractSolver
    reason: str
    at_start: AtStart | None = None
    excess: float = 0.0


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


@lru_cache(maxsize=64)
def choice_by_structure(structure: Structure) -> SolverChoice | None:
    """The choice for a system in which nothing can be too fast, whatever its numbers; None where they decide."""
    if structure.code or not is_own(structure.tree):  # what a part says of itself may hang on its numbers
        return None
    example = example_of(structure)
    may_be_stiff = any(_may_be_stiff(called(example, "spherical", name).model) for name in example.force_joints)
    if may_be_stiff or example.friction_joints or example.forces or example.force_states:
        return None
    return SolverChoice(diffrax.Dopri8(), NOTHING_IN_JOINTS)


def stiffest(choices: Sequence[SolverChoice]) -> SolverChoice:
    """The choice for several runs that are to be made by one method: a stiff one if any of them asks for it."""
    stiff = [choice for choice in choices if not isinstance(choice.solver, diffrax.AbstractERK)]
    return (stiff or choices)[0]


def _choice(system: System, known_rtol: float) -> SolverChoice:
    """The choice by whatever asks most for a stiff method; where nothing does, by all that was looked at."""
    by_joints = _choice_by_joints(system, known_rtol)
    if isinstance(by_joints.solver, Rodas5P):
        return by_joints
    others = []
    if system.friction_joints:
        others.append(_choice_by_friction(system))
    if system.forces:
        others.append(_choice_by_forces(system, known_rtol))
    if system.force_states:
        others.append(_choice_by_memory(system, known_rtol))
    # The W-method leaves out of its Jacobian all but the joints' forces: what else is too fast needs the exact one.
    stiff = [choice for choice in others if isinstance(choice.solver, Rodas5P)]
    if stiff:
        return max(stiff, key=lambda choice: choice.excess)
    if not isinstance(by_joints.solver, diffrax.Dopri8):
        return by_joints
    said = [by_joints.reason, *(choice.reason for choice in others)]
    if system.friction_joints and by_joints.reason == NOTHING_IN_JOINTS:
        del said[0]
    reason = "; ".join([said[0], *(part.removeprefix("Dopri8: ") for part in said[1:])])
    return by_joints._replace(reason=reason)


def _choice_by_joints(system: System, known_rtol: float) -> SolverChoice:
    looked_at = [name for name in system.force_joints if _may_be_stiff(called(system, "spherical", name).model)]
    if not looked_at:
        return SolverChoice(diffrax.Dopri8(), NOTHING_IN_JOINTS)
    structure, theta = flatten_system(system)
    if not is_concrete(theta):
        resistance = {name: system.spherical(name).model.medium for name in looked_at}
        return _choice_by_models(resistance, known_rtol, may_have_both=_is_small(structure))
    fastest = _fastest(system, structure, theta, known_rtol)
    if fastest.per_second == 0:
        return SolverChoice(diffrax.Dopri8(), "Dopri8: no joint's friction is stiffer than its contact")
    what = f"joint {fastest.joint!r} {fastest.how} at about {fastest.per_second:.1e} per second"
    stiff = _priced(stiff_method(known_rtol), structure)
    return _by_rate(what, fastest.per_second, fastest.limit(known_rtol), stiff)


class _Priced(NamedTuple):
    """A stiff method for a system: how many times dearer its steps are than on the four-bar."""

    solver: diffrax.AbstractSolver
    times: Callable[[], float]


def _priced(method: StiffMethod, structure: Structure) -> _Priced:
    """Its price is asked for only where a rate is beyond the usual limit: the linear systems are made for it."""
    return _Priced(method.solver, lambda: _times_dearer(method, structure))


def _times_dearer(method: StiffMethod, structure: Structure) -> float:
    """How many times more its step costs, in steps of Dopri8, than `method.price`, which is that of a mechanism whose
    linear systems are eliminated as a scalar program."""
    systems = inexact_systems_of(structure) if method is LOOSE else systems_of(structure)
    rate = program_for(state_rate, structure).scalar
    if rate is None or (systems is not None and systems.stage.scalar is not None):
        return 1.0
    layout, n_constraints = sizes_of(structure)
    unknowns = layout.size - layout.n_position + n_constraints
    return max(1.0, ARRAY_ELIMINATION * unknowns**3 / rate.n_operations / method.price)


def _by_rate(what: str, rate: float, limit: float, stiff: _Priced, where: str = " at this rtol") -> SolverChoice:
    """The stiff method where a rate [1/s] is beyond the limit, raised where its steps are dear; else Dopri8."""
    times = stiff.times() if rate > limit else 1.0
    limit, name = limit * times, type(stiff.solver).__name__
    if rate > limit:
        reason = f"{name}: {what}, beyond {limit:.1e}, where explicit steps cost more{where}"
        return SolverChoice(stiff.solver, reason, excess=rate / limit)
    dear = f" ({name} would solve dense linear systems of this size)" if times > 1 else ""
    return SolverChoice(
        diffrax.Dopri8(), f"Dopri8: {what}, below {limit:.1e}, where stiff steps cost more{where}{dear}"
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
        return SolverChoice(diffrax.Dopri8(), "Dopri8: numbers are traced, and force elements not looked at")
    limit = STABILITY_BOUND * TIGHT.cost(rtol) * FOUR_BAR_TIME / float(time_scale(system))
    # Constraints only slow things down: with them only what is too fast without them is looked at.
    rate = force_rates(system, structure, np.asarray(theta), constrained=False).fastest
    if rate > limit:
        rate = force_rates(system, structure, np.asarray(theta)).fastest
    if rate == 0:
        return SolverChoice(diffrax.Dopri8(), "Dopri8: force elements damp nothing at the start")
    what = f"force elements act at about {rate:.1e} per second or slower"
    return _by_rate(what, rate, limit, _priced(TIGHT, structure))


def _choice_by_memory(system: System, rtol: float) -> SolverChoice:
    """Rodas5P where states of force elements are too fast for Dopri8, such as a controller's filter."""
    structure, theta = flatten_system(system)
    if not is_concrete(theta):
        return SolverChoice(diffrax.Dopri8(), "Dopri8: nor are states of force elements")
    limit = STABILITY_BOUND * TIGHT.cost(rtol) * FOUR_BAR_TIME / float(time_scale(system))
    rates = friction_rates(system, structure, np.asarray(theta)).by_force
    name, rate = max(((name, rates[name].fastest) for name in rates), key=lambda found: found[1], default=("", 0.0))
    if rate == 0:
        return SolverChoice(diffrax.Dopri8(), "Dopri8: states of force elements do not decay")
    what = f"the states of force element {name!r} change at about {rate:.1e} per second"
    return _by_rate(what, rate, limit, _priced(TIGHT, structure))


def _choice_by_friction(system: System) -> SolverChoice:
    """Rodas5P where friction in ideal joints is too fast for Dopri8: the W-method leaves it out of its Jacobian."""
    structure, theta = flatten_system(system)
    if not is_concrete(theta):
        return SolverChoice(diffrax.Dopri8(), "Dopri8: friction in ideal joints; numbers are traced")
    limit = STABILITY_BOUND * TIGHT.price * STEPS_WITH_FRICTION / float(time_scale(system))
    rate = friction_rates(system, structure, np.asarray(theta)).others.fastest
    what = f"friction in ideal joints acts at about {rate:.1e} per second"
    return _by_rate(what, rate, limit, _priced(TIGHT, structure), where="")


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
    models = {name: called(system, "spherical", name).model for name in system.force_joints}
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
