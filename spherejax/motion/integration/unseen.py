"""Pulses of functions of time that a step would pass over.

Of a function of the user's own nothing is known: a pulse between two stages of a step has no part in its error, and a
push of 1 N s within 1e-4 s left a ball at rest. So the function is looked at between the stages as well, at `LOOKS`
instants of the whole motion, and compared with a polynomial through the stages. Where it is farther from that than the
stages are themselves, the step is made again, up to the last instant at which the two agree, but no shorter than the
distance of two instants: such a step sees the pulse by its stages, and its error judges it. What is shorter can be
missed; `sj.functions.Piecewise` says where to look.

With that a step accepts what its own error has seen: stages that scatter about the polynomial (noise, a kink) allow the
same between them. Only scenes with such functions have this; functions of the package know where they turn
(`distance_to_breakpoint`).
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System, example_of
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.longest_step import STEPS_AT_LEAST
from spherejax.motion.start.tolerances import energy_scale, length_scale
from spherejax.physics.state import unpack

LOOKS = 20_000
"""Instants over the whole motion at which functions are looked at, beside the stages: what lasts for 1/20,000 of it is
seen. A step of a hundredth of the motion, the longest, has 200."""

LOOKS_IN_LONGEST = LOOKS // STEPS_AT_LEAST

BLOCK = 20
"""Instants that are evaluated side by side."""

DEGREE = 5
"""Of the polynomial: methods have six stages or more at different instants; of one with fewer it is lower."""

SCATTER = 30.0
"""Between the stages a function may be so many times as far from the polynomial as at the stages. Sines of up to two
cycles in a step are no farther than 6 times."""

OF_RANGE = 1e-6
"""... or this share of what it changes in the step, which is what rounding leaves of a smooth one, and..."""

COARSE_OF_RANGE = 1e-3
"""The same where the method has too few stages to say how smooth the function is."""

NOTHING = 1e-11
"""... this share of the forces, moments and lengths of the scene, which no tolerance sees: tails of a Gauss pulse."""


def time_signals(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " m"]:
    """Values of the functions of time of which nothing is known, in units of the scene; see `component_tolerances`.

    Functions of time and of the motion are evaluated with the motion of the state.
    """
    state = unpack(system.layout, y)
    motions = body_motions(system, state)
    length, energy = length_scale(system), energy_scale(system)
    units = {"N": energy / length, "N m": energy, "m": length, "1": 1.0}
    forces: Any = system.forces_with(state.memory)
    signals = [
        jnp.ravel(jnp.asarray(value, jnp.float64)) / units[unit]
        for force in forces.values()
        for value, unit in force.unknown_in_time(t, motions)
    ]
    return jnp.concatenate([jnp.zeros(0), *signals])


@lru_cache(maxsize=64)
def signals_for(structure: Structure, scalar: bool | None) -> Callable | None:
    """The same as a program (theta, t, y); None for a system without, and for one whose functions read no time."""
    system = example_of(structure)
    number, state = (jax.ShapeDtypeStruct(shape, jnp.float64) for shape in ((), (system.layout.size,)))
    if not jax.eval_shape(time_signals, system, number, state).size:
        return None
    program = program_for(time_signals, structure, scalar, is_quiet=True)
    return program if program.reads_time else None


@lru_cache(maxsize=64)
def bound_in_words(structure: Structure, scalar: bool | None) -> str:
    """How short a pulse of a user's function may be, for a run's explanation; empty for a system without one."""
    if signals_for(structure, scalar) is None:
        return ""
    names: list[str] = []

    def look(system, t, y):
        state = unpack(system.layout, y)
        motions, forces = body_motions(system, state), system.forces_with(state.memory)
        names.extend(name for name, force in forces.items() if force.unknown_in_time(t, motions))
        return t

    system = example_of(structure)
    number, flat = (jax.ShapeDtypeStruct(shape, jnp.float64) for shape in ((), (system.layout.size,)))
    jax.eval_shape(look, system, number, flat)
    of = ", ".join(f"force {name!r}" for name in names)
    return f"functions of time of your own ({of}): a pulse shorter than 1/{LOOKS:,} of the motion can be missed"


class Unseen(NamedTuple):
    """Looks at functions of time between the stages of a step (static).

    Attributes:
        signals: their values, a function of (parameters, t, y).
        instants: of the method's stages that its error knows, as shares of a step.
    """

    signals: Callable
    instants: tuple[float, ...]

    def shortened(self, longest, parameters, t0, size, y, bend=0.0) -> Float[Array, ""]:
        """The size that a step [s] must have to pass over nothing; its own where it passes over nothing.

        Args:
            longest: the longest step of the run [s]; it is looked at `LOOKS_IN_LONGEST` times.
            parameters: what the right-hand side is given.
            t0: start of the step [s].
            size: of the step [s]; nothing is looked at in one of size zero.
            y: state at its end.
            bend: of the time that it is made in; see `lanes.stages`.
        """
        parameters, t0, size, y, bend = jax.lax.stop_gradient((parameters, t0, size, y, bend))
        spacing = jax.lax.stop_gradient(longest) / LOOKS_IN_LONGEST
        nodes, degree, scatters, of_range = _nodes(self.instants)
        vandermonde = np.vander(2 * nodes - 1, degree + 1)
        signals = jax.vmap(lambda t: self.signals(parameters, t, y))
        at_nodes = signals(t0 + size * nodes * (1 - bend * (1 - nodes)))
        coefficients = jnp.asarray(np.linalg.pinv(vandermonde)) @ at_nodes
        scatter = jnp.max(jnp.abs(at_nodes - jnp.asarray(vandermonde) @ coefficients), axis=0)
        low, high = jnp.min(at_nodes, axis=0), jnp.max(at_nodes, axis=0)
        rounding = 1e-12 * jnp.maximum(jnp.abs(low), jnp.abs(high))
        allowed = scatters * scatter + of_range * (high - low) + rounding + NOTHING
        n = jnp.where(size > spacing, jnp.ceil(size / spacing) - 1, 0.0)

        def look(carry):
            _, begin = carry
            numbers = begin + 1 + jnp.arange(BLOCK)
            shares = numbers / (n + 1)
            # The time within a bent step: see `lanes.stages.own_time`.
            straight = 1 - bend
            root = straight + jnp.sqrt(jnp.maximum(straight * straight + 4 * bend * shares, 0.0))
            own = 2 * shares / jnp.where(root > 0, root, 1.0)
            away = jnp.abs(signals(t0 + size * shares) - _powers(2 * own - 1, degree) @ coefficients)
            is_new = jnp.any(away > allowed, axis=1) & (numbers <= n)
            return jnp.min(jnp.where(is_new, numbers, jnp.inf)), begin + BLOCK

        first, _ = jax.lax.while_loop(
            lambda carry: jnp.isinf(carry[0]) & (carry[1] < n), look, (jnp.full((), jnp.inf), jnp.zeros(()))
        )
        last_quiet = size * (first - 1) / (n + 1)
        return jnp.where(jnp.isinf(first), size, jnp.maximum(last_quiet, spacing))


def unseen_of(structure: Structure, scalar: bool | None, solver: Any) -> Unseen | None:
    """What looks between the stages of the steps of a method; None for a system where there is nothing to look at."""
    signals = signals_for(structure, scalar)
    if signals is None:
        return None
    return Unseen(lambda parameters, t, y: signals(parameters.theta, t, y), _judged_instants(solver))


def _judged_instants(solver: Any) -> tuple[float, ...]:
    """Instants of the stages that have a weight in the error's estimate, as shares of a step.

    A pulse on another stage has no part in the error, and would only make the polynomial's stages scatter: Dopri8's
    stage for states inside a step alone took a push of 1e-4 s so.
    """
    tableau: Any = getattr(solver, "tableau", None)
    errors = getattr(tableau, "b_error", None)  # the weights of our Rosenbrock methods are of other variables
    instants = np.ravel(getattr(tableau, "c", ()))
    if errors is None or np.ndim(errors) != 1:
        return tuple(map(float, instants))
    if len(instants) == len(errors) - 1:  # diffrax leaves out the first stage
        instants = np.append(getattr(tableau, "c1", 0.0), instants)
    is_judged = np.abs(np.asarray(errors)) > 1e-12 if len(instants) == len(errors) else slice(None)
    return tuple(map(float, instants[is_judged]))


def _nodes(instants: tuple[float, ...]) -> tuple[np.ndarray, int, float, float]:
    """Where the polynomial is made from, its degree, and what is allowed: a factor of scatter, a share of the range.

    It does not pass through all stages. Of a method with too few it is made from, and passes through, instants that
    its error knows nothing of: their scatter allows nothing.
    """
    nodes = np.unique(np.round(instants, 12)) if instants else np.zeros(0)
    if len(nodes) < 4:
        return np.linspace(0.0, 1.0, 5), 4, 0.0, COARSE_OF_RANGE
    return nodes, min(DEGREE, len(nodes) - 2), SCATTER, OF_RANGE


def _powers(x: Array, degree: int) -> Array:
    return jnp.stack([x**k for k in range(degree, -1, -1)], axis=-1)
