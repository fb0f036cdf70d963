"""Equilibria of a corner whose joints give way, at a given travel and steer, under loads.

The unknowns are small motions x of the bodies from the position of the ideal joints, and the multipliers lambda:

    g(x) - D^T lambda = 0,    Phi(x) = 0

solved by Newton's method with a step that is halved while it does not help. In scaled unknowns the matrix is
[H D^T; D 0], with H = -dg/dx the stiffness; a share of 1e-10 on its diagonal takes what is free to spin, and equations
that depend on others, without moving the solution, which is where the left sides vanish.

Where the search starts, says `start.py`. At rest a film carries nothing, and friction holds anything within a band: the
latter is left out, the former refused (`study.py`).

Derivatives: at an equilibrium three steps with the inverse of the matrix as it is there are made whose derivatives are
followed. Each raises by one the order up to which derivatives of the solution are exact.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System, example_of
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set
from spherejax.motion.equations.loads import applied_wrenches, joint_loads
from spherejax.motion.equations.programs import program_for
from spherejax.physics.state import VELOCITY_SIZE, Layout, pack, unpack
from spherejax.studies.rig.bench import N_INPUTS, PLATFORM, moved, platform_of, with_inputs
from spherejax.studies.rig.characteristics import Holding, RigCurves, curves_of
from spherejax.studies.rig.shown import RigStatus
from spherejax.studies.rig.start import Starter, rows_of

N_STEPS = 40
"""Newton steps at most; rubber takes four to six, a dry ball up to ten."""

N_HALVINGS = 8
"""Times that a step is halved while it does not help."""

SETTLED = 1e-11
"""Largest scaled step (a share of the scale of length, rad) after which nothing moves; rounding leaves 1e-13."""

BALANCED = 1e-9
"""Largest scaled residual of an equilibrium."""

LENGTH = 1.0
"""Scale by which motions and turns, forces and moments are compared [m]: that of a suspension."""

REGULARIZATION = 1e-10
"""Share of the largest stiffness, and of each equation, on the diagonal."""

N_FOLLOWED = 3
"""Steps whose derivatives are followed."""

# The equations ----------------------------------------------------------------------------------------------------


class RigSlopes(NamedTuple):
    """The equations of an equilibrium and their derivatives.

    Attributes:
        wrenches: g - D^T lambda of all bodies [N, N m], shape (n,).
        residual: Phi [m or 1], shape (m,).
        by_step: derivatives of the wrenches by motions of the bodies, shape (n, n).
        rows: D, shape (m, n).
        forced: derivatives of the wrenches by the inputs, shape (n, 6).
        driven: those of Phi, shape (m, 6).
    """

    wrenches: Any
    residual: Any
    by_step: Any
    rows: Any
    forced: Any
    driven: Any


def rig_balance(system: System, t: Scalar, numbers) -> tuple[Float[Array, " n"], Float[Array, " m"]]:
    """g - D^T lambda of all bodies [N, N m], and Phi [m or 1]."""
    y, multipliers, inputs = numbers
    system = with_inputs(system, inputs)
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    constraints = constraint_set(system, t, motions)
    loads = joint_loads(system, motions, state.memory)
    wrenches = applied_wrenches(system, t, motions, state.memory, loads) - constraints.transposed_times(multipliers)
    return wrenches.ravel(), constraints.residual


def rig_slopes(system: System, t: Scalar, numbers) -> RigSlopes:
    """The same with its derivatives."""
    y, multipliers, inputs = numbers

    def at(step):
        return rig_balance(system, t, (_moved(system.layout, y, step), multipliers, inputs))

    def by(given):
        return rig_balance(system, t, (y, multipliers, given))

    by_step, rows = jax.jacfwd(at)(jnp.zeros(VELOCITY_SIZE * system.layout.n_bodies))
    return RigSlopes(*by(inputs), by_step, rows, *jax.jacfwd(by)(inputs))


def _moved(layout: Layout, y: Array, step: Array) -> Array:
    state = unpack(layout, y)
    position, quaternion = moved(state.position, state.quaternion, step.reshape(-1, VELOCITY_SIZE))
    return pack(state._replace(position=position, quaternion=quaternion))


def rig_shift(system: System, t: Scalar, numbers) -> Float[Array, " size"]:
    """A state after small motions of the bodies."""
    del t
    y, step = numbers
    return _moved(system.layout, y, step)


def rig_characteristics(system: System, t: Scalar, numbers) -> RigCurves:
    """Characteristics at an equilibrium, from the derivatives of the motions and the reactions of the drivers.

    Args (in `numbers`):
        y: flat state.
        steps: derivatives of the bodies' places by the inputs, shape (6 n,).
        held: wheel load, steering effort, wheel rate, shape (3,).
        inputs: travel, steer, loads.
    """
    del t
    y, steps, held, inputs = numbers
    system = with_inputs(system, inputs)
    effort = None if platform_of(system).corner.steering is None else held[1]
    state = unpack(system.layout, y)
    return curves_of(system, state, steps.reshape(N_INPUTS, -1, VELOCITY_SIZE), Holding(held[0], effort), held[2])


class RealPrograms:
    """The functions of a system with its joints as they are.

    Attributes:
        held: where the equations of the drivers are.
    """

    def __init__(self, structure: Structure, ideal: Structure):
        system = example_of(structure)
        self.starter = Starter(structure, ideal)
        size, n, m = system.layout.size, system.layout.n_velocity, system.n_constraints
        self._balance, self._slopes = (
            program_for(function, structure, True, (size, m, N_INPUTS)) for function in (rig_balance, rig_slopes)
        )
        self._shift = program_for(rig_shift, structure, True, (size, n))
        self._read = program_for(rig_characteristics, structure, True, (size, N_INPUTS * n, 3, N_INPUTS))
        places = rows_of(system)
        self.held = [int(places[name][0]) for name in (PLATFORM, platform_of(system).corner.steering or PLATFORM)]

    def of(self, theta, is_known: bool) -> "RigEquations":
        """The equations of numbers: evaluated at once where they are known, else in JAX."""
        function: Callable = _computed if is_known else _called
        programs = (self._balance, self._slopes, self._shift, self._read)
        return RigEquations(*(function(program, theta) for program in programs))


def _computed(program, theta) -> Callable:
    return lambda *numbers: program.compute(theta, 0.0, numbers)


def _called(program, theta) -> Callable:
    return lambda *numbers: program(theta, 0.0, numbers)


class RigEquations(NamedTuple):
    """Functions of known or traced numbers; see `rig_balance`, `rig_slopes`, `rig_shift`, `rig_characteristics`."""

    balance: Callable
    slopes: Callable
    shifted: Callable
    read: Callable


# The solution ------------------------------------------------------------------------------------------------------


class SaddleSystem(NamedTuple):
    """[H D^T; D 0] in scaled unknowns.

    Attributes:
        matrix: of them.
        steps: units of the motions of the bodies [m, rad].
        stiffness: unit of the multipliers [N m].
        rows: sizes of the equations [m or 1].
    """

    matrix: Any
    steps: Any
    stiffness: Any
    rows: Any

    def right(self, wrenches: Any, residual: Any) -> Any:
        """Scaled left sides of the equations, to be answered."""
        xp: Any = np if isinstance(wrenches, np.ndarray) else jnp
        return xp.concatenate([wrenches.T * self.steps / self.stiffness, -residual.T / self.rows], -1).T

    def solve(self, wrenches: Any, residual: Any) -> tuple[Any, Any]:
        """Motions and multipliers that answer what is left; of several as columns."""
        xp: Any = np if isinstance(wrenches, np.ndarray) else jnp
        right = self.right(wrenches, residual)
        found = xp.linalg.solve(self.matrix, right if right.ndim > 1 else right[:, None])
        found = found if right.ndim > 1 else found[:, 0]
        n = wrenches.shape[0]
        return (found[:n].T * self.steps).T, (found[n:].T * self.stiffness / self.rows).T


def linear_of(slopes: RigSlopes) -> SaddleSystem:
    """Scaled, with a small share on the diagonal."""
    xp: Any = np if isinstance(slopes.by_step, np.ndarray) else jnp
    constant = (lambda x: x) if xp is np else jax.lax.stop_gradient
    n, m = slopes.by_step.shape[0], slopes.rows.shape[0]
    steps = np.tile([LENGTH] * 3 + [1.0] * 3, n // VELOCITY_SIZE)
    H = -slopes.by_step * steps[:, None] * steps
    D = slopes.rows * steps
    stiffness = constant(xp.max(xp.abs(H)))
    sizes = constant(xp.sqrt(xp.sum(D * D, 1)))
    D = D / sizes[:, None]
    upper = xp.concatenate([H / stiffness + REGULARIZATION * np.eye(n), D.T], 1)
    lower = xp.concatenate([D, -REGULARIZATION * xp.eye(m)], 1)
    return SaddleSystem(xp.concatenate([upper, lower]), steps, stiffness, sizes)


class RigEquilibrium(NamedTuple):
    """An equilibrium, with the equations there.

    Attributes:
        y: flat state.
        multipliers: of the constraints.
        slopes: the equations and their derivatives.
        status: `RigStatus`.
    """

    y: Any
    multipliers: Any
    slopes: RigSlopes
    status: Any


class _Trial(NamedTuple):
    """A state on its way, and how far the last step went and what it left."""

    y: Any
    multipliers: Any
    slopes: RigSlopes
    step: Any
    left: Any


def _size(linear: SaddleSystem, wrenches: Any, residual: Any) -> Any:
    right = linear.right(wrenches, residual)
    return (right * right).sum()


def _stepped(equations: RigEquations, y: Any, multipliers: Any, inputs: Any, xp: Any) -> _Trial:
    """A step of Newton's method, halved until it helps."""
    slopes = equations.slopes(y, multipliers, inputs)
    linear = linear_of(slopes)
    step, more = linear.solve(slopes.wrenches, slopes.residual)
    before = _size(linear, slopes.wrenches, slopes.residual)

    def after(share):
        state = equations.shifted(y, share * step)
        return _size(linear, *equations.balance(state, multipliers + share * more, inputs))

    def is_worse(tried):
        _, left, k = tried
        return (k < N_HALVINGS) & ~(left <= before + BALANCED**2)

    def halved(tried):
        share, _, k = tried
        return 0.5 * share, after(0.5 * share), k + 1

    if xp is np:
        tried = (1.0, after(1.0), 0)
        while is_worse(tried):
            tried = halved(tried)
    else:
        # The first trial is made in the loop too: a program holds the equations once.
        first = (jnp.asarray(2.0), jnp.asarray(jnp.inf), jnp.asarray(-1))
        tried = jax.lax.while_loop(is_worse, halved, first)
    share, left, _ = tried
    return _Trial(
        equations.shifted(y, share * step),
        multipliers + share * more,
        slopes,
        xp.max(xp.abs(step / linear.steps)),
        left,
    )


def equilibrium_from(equations: RigEquations, y: Any, multipliers: Any, inputs: Any, xp: Any) -> RigEquilibrium:
    """The equilibrium near a state."""
    if xp is np:
        trial = _stepped(equations, y, multipliers, inputs, np)
        for _ in range(N_STEPS):
            if not trial.step > SETTLED or not np.isfinite(trial.step):
                break
            trial = _stepped(equations, trial.y, trial.multipliers, inputs, np)
    else:

        def body(found):
            trial, k = found
            return _stepped(equations, trial.y, trial.multipliers, inputs, jnp), k + 1

        def goes_on(found):
            trial, k = found
            return (k < N_STEPS) & (trial.step > SETTLED)

        shapes = jax.eval_shape(lambda: _stepped(equations, y, multipliers, inputs, jnp))
        empty = jax.tree.map(lambda each: jnp.zeros(each.shape, each.dtype), shapes)
        start = empty._replace(y=y, multipliers=multipliers, step=jnp.asarray(jnp.inf))
        trial, _ = jax.lax.while_loop(goes_on, body, (start, 0))
    good = (trial.step <= SETTLED) & (trial.left < BALANCED**2)
    status = xp.where(good, int(RigStatus.FOUND), int(RigStatus.NO_EQUILIBRIUM))
    return RigEquilibrium(trial.y, trial.multipliers, trial.slopes, status)


def followed(equations: RigEquations, found: RigEquilibrium, inputs: Array) -> RigEquilibrium:
    """The equilibrium, with the derivatives of the solution by all numbers."""
    y, multipliers = jax.lax.stop_gradient((found.y, found.multipliers))
    linear = jax.lax.stop_gradient(linear_of(found.slopes))

    def step(at, _):
        y, multipliers = at
        move, more = linear.solve(*equations.balance(y, multipliers, inputs))
        return (equations.shifted(y, move), multipliers + more), None

    (y, multipliers), _ = jax.lax.scan(step, (y, multipliers), length=N_FOLLOWED)
    return RigEquilibrium(y, multipliers, equations.slopes(y, multipliers, inputs), found.status)


def characteristics_at(
    programs: RealPrograms, equations: RigEquations, found: RigEquilibrium, inputs: Any, xp: Any
) -> RigCurves:
    """The characteristics at an equilibrium, with the derivatives by travel, steer and all loads."""
    slopes = found.slopes
    linear = linear_of(slopes)
    steps, more = linear.solve(slopes.forced, slopes.driven)
    # A second pass takes what the regularization has left.
    left = slopes.forced + slopes.by_step @ steps - slopes.rows.T @ more
    again, rest = linear.solve(left, slopes.driven + slopes.rows @ steps)
    steps, more = steps + again, more + rest
    platform, steering = programs.held
    # -lambda is the force with which a driver acts.
    held = -xp.stack([found.multipliers[platform], found.multipliers[steering], more[platform, 0]])
    return equations.read(found.y, steps.T.ravel(), held, inputs)
