"""Tolerances per component: what counts as an error in a position, a velocity, a memory, in the scales of the scene.

One relative and one absolute tolerance treat an eccentricity of 1e-7 m like the positions of 0.1 m that it is the
difference of. Here each kind of component has a scale of its own, and positions of a scene with clearances are judged
against the clearance.
"""

import itertools
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import diffrax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.types import Number, Numeric, Scalar
from spherejax.model.picking import Picked, picked
from spherejax.model.system import Structure, System, example_of
from spherejax.physics.state import Layout
from spherejax.program_cache import cached_jit

ABSOLUTE_SHARE = 1e-2
"""Absolute tolerance of a component as a share of the relative one times its scale."""

CLEARANCES = 1e4
"""Positions are judged as if they were at most this many clearances, those of balls and of journals.

`benchmarks/clearance_tolerances.py` has fewer: 100, 10 and 1. Velocities set the steps through dry contact: with ten
clearances the errors are of the same size, for steps within 3 %. With films ten take 4 to 30 % more steps, of a journal
at 1e-6 3.6 times; a tighter `rtol` gives as much for these steps, within a factor of three. The error of a whole run
within the clearance, 2e-8 to 1e-2 of it at 1e-8, has been amplified by the motion: `run.error` estimates it, and
`accuracy=` chooses the tolerance by it."""

ROUNDING = float(np.finfo(np.float64).eps)

LEAST_ROUNDING = 5e-14
"""Relative tolerance below which any motion is solved for its rounding: the ideal four-bar takes 94 steps at 1e-13 and
703 at 1e-14, to the same digits."""

ELASTIC_ROUNDING = 3e-13
"""Relative tolerance below which joints that answer with a force are solved for their rounding: deflections are small
differences of positions. A bushing of 1e6 N/m on the four-bar takes 2,066 steps at 1e-12 and 8,962 at 1e-13, to the
same digits."""

FILM_SHARE = 1e-2
"""Of the smallest clearance: what thicknesses of films and deflections of their liners are judged by, a micrometer in
a clearance of 0.1 mm. A length of its own, in meters, would loosen or tighten the steps with the clearance, and with
the unit of length."""

SMALLEST_LENGTH = 1e-3
"""Scale [m] of a scene that shows no length of its own."""


class Tolerances(NamedTuple):
    """Tolerances of each entry of the flat state, for `diffrax.PIDController`.

    Attributes:
        rtol: relative, shape (size,) or a number.
        atol: absolute, in the units of the entry, shape (size,) or a number.
        description: in words.
    """

    rtol: Any
    atol: Any
    description: str


def component_tolerances(system: System, rtol: Number) -> Tolerances:
    """Tolerances by the scales of a scene.

    With the length L (the farthest position or joint place), the speed V = (g L)^(1/2) + the largest initial speeds,
    and the energy m V^2 (m: all masses):

        positions    rtol min(1, 1e4 c / L) relative, 1e-2 of that times L absolute; c is the smallest clearance
        quaternions  rtol, 1e-2 rtol
        velocities   rtol, 1e-2 rtol V;  angular velocities  rtol, 1e-2 rtol V / L
        memory       as velocities; deflections that a bushing remembers as positions, rotations as quaternions;
                     forces by m V^2 / L, moments by m V^2; thicknesses of a film by c / 100; what has a scale of
                     its own by that
        work         rtol, 1e-2 rtol m V^2

    A tolerance below what rounding leaves is lifted to it, and the description says so: see `rounding_floor`.
    """
    if is_concrete(rtol) and all(map(is_concrete, _measures(system))):
        return _described(_numbers(system, rtol), rtol, is_known=True)
    found = _traced_numbers(system, np.asarray(rtol) if is_concrete(rtol) else rtol)
    # What of it does not hang on what is traced is known.
    if is_concrete(rtol) and not (system.force_joints and _has_traced_scales(system)):
        found = found._replace(rtol=_lifted(rtol, rounding_floor(system)))
    return _described(found, rtol, is_known=False)


def known_tolerances(structure: Structure, theta: Float[np.ndarray, " p"], rtol: float) -> Tolerances | None:
    """`component_tolerances` of a system of known numbers, to the same bits; None where it has to be looked at whole.

    Args:
        structure, theta: the system, taken apart.
        rtol: as there.
    """
    at = _measured_at(structure)
    if at is None:
        return None
    parts = [*(kind.flat(theta) for kind in at.vectors), at.clearances.flat(theta)]
    if at.depends_on_masses:
        parts.append(at.masses.flat(theta))
    return _tolerances_by(structure, tuple(part.tobytes() for part in parts), float(rtol))


@lru_cache(maxsize=256)
def _tolerances_by(structure: Structure, numbers: tuple[bytes, ...], rtol: float) -> Tolerances:
    """Kept by the numbers that they are made of, which are few: a mass, or a law's number, is seldom among them."""
    at = _measured_at(structure)
    assert at is not None
    masses = np.frombuffer(numbers[-1]).tolist() if at.depends_on_masses else []
    vectors, clearances = numbers[: len(at.vectors)], np.frombuffer(numbers[len(at.vectors)])
    scales = (*_length_and_speed_by(vectors), _smallest(np, clearances))
    return _described(_numbers_of(at.kinds, scales, masses, rtol), rtol, is_known=True)


@lru_cache(maxsize=256)
def _length_and_speed_by(numbers: tuple[bytes, ...]) -> tuple:
    """Length and speed, by the vectors that they are made of."""
    return _length_and_speed_of(np, [np.frombuffer(vector).reshape(-1, 3) for vector in numbers])


class _Measured(NamedTuple):
    """Where the numbers are that tolerances are made of.

    Attributes:
        kinds: of the entries of the state.
        vectors: places, velocities, angular velocities, gravity.
        clearances, masses: of joints and bodies.
    """

    kinds: "_Kinds"
    vectors: tuple[Picked, ...]
    clearances: Picked
    masses: Picked

    @property
    def depends_on_masses(self) -> bool:
        """Whether an entry of the state is judged by an energy, a force or a moment."""
        return bool(self.kinds.layout.n_work) or not {"force", "moment"}.isdisjoint(self.kinds.memory)


@lru_cache(maxsize=64)
def _measured_at(structure: Structure) -> _Measured | None:
    """In the numbers of systems of a structure; None where they are not there as they are."""
    functions = [lambda system, i=i: _lengths_and_speeds(system)[i] for i in range(4)]
    functions += [lambda system: system.gravity, lambda system: [body.mass for body in system.bodies.values()]]
    numbers = [one for one in (picked(function, structure) for function in functions) if one is not None]
    if len(numbers) < len(functions):  # before anything else is asked: no user code is in it
        return None
    kinds = _kinds_of(example_of(structure))
    if not all(isinstance(scale, str) for scale in kinds.memory):
        return None
    places, velocities, spins, clearances, gravity, masses = numbers
    return _Measured(kinds, (places, velocities, spins, gravity), clearances, masses)


def _described(found: "_Numbers", rtol: Number, *, is_known: bool) -> Tolerances:
    """Tolerances, and words on them."""
    text = f"rtol {found.rtol:.0e}" if is_concrete(found.rtol) else "rtol traced"
    if is_concrete(found.rtol) and found.rtol > rtol:
        text = f"rtol {found.rtol:.0e} in place of {rtol:.0e}, which is below rounding"
    if is_known:
        text += (
            f" (positions {found.rtol * float(found.fine):.0e}), "
            f"atol {ABSOLUTE_SHARE * found.rtol * float(found.fine * found.length):.0e} m, "
            f"{ABSOLUTE_SHARE * found.rtol * float(found.speed):.0e} m/s, "
            f"{ABSOLUTE_SHARE * found.rtol * float(found.speed / found.length):.0e} rad/s"
        )
    return Tolerances(found.relative, found.absolute, text)


def tolerances_of(system: System, rtol, atol) -> Tolerances:
    """Tolerances of each entry of the state, by the scales of the scene unless they are given."""
    if atol is not None:
        return Tolerances(rtol, atol, "tolerances as asked for")
    return component_tolerances(system, rtol)


def tolerances_in_all_units(rtol) -> Tolerances:
    """The same for all entries: root finders of diffrax take their tolerances from the controller, as numbers."""
    return Tolerances(rtol, 1e-2 * rtol, "atol 1e-2 rtol in all units")


class _Numbers(NamedTuple):
    """What tolerances are made of.

    Attributes:
        rtol: relative, no less than rounding leaves.
        fine: factor of that for positions.
        length, speed: of the scene [m, m/s].
        relative, absolute: of each entry of the flat state, shape (size,).
    """

    rtol: Any
    fine: Any
    length: Any
    speed: Any
    relative: Any
    absolute: Any


class _Kinds(NamedTuple):
    """What kinds of entries a state has (static).

    Attributes:
        layout: where they are.
        answers_with_force: whether a joint does.
        memory: scales of what is remembered, in words or numbers.
    """

    layout: Layout
    answers_with_force: bool
    memory: tuple


def _kinds_of(system: System) -> _Kinds:
    memory = tuple(entry.scale for slot in system.all_slots for entry in slot.contents)
    return _Kinds(system.layout, bool(system.force_joints), memory)


def _numbers(system: System, rtol: Number) -> _Numbers:
    return _numbers_of(_kinds_of(system), _scales(system), [body.mass for body in system.bodies.values()], rtol)


def _numbers_of(kinds: _Kinds, scales: tuple, masses: list, rtol: Number) -> _Numbers:
    length, speed, clearance = scales
    rtol = _lifted(rtol, _rounding_floor(kinds.answers_with_force, length, clearance))
    xp: Any = np if all(is_concrete(value) for value in (rtol, length, speed, clearance, *masses)) else jnp
    fine = xp.minimum(1.0, CLEARANCES * clearance / length)
    energy = sum(masses) * speed * speed
    relative = _by_kind(kinds.layout, xp, fine, 1.0, 1.0, 1.0, 1.0, 1.0)
    usual = {
        "length": fine * length,
        "angle": 1.0,
        "speed": speed,
        "angular_speed": speed / length,
        "force": energy / length,
        "moment": energy,
        "film": FILM_SHARE * xp.minimum(clearance, length),
    }
    memory = speed
    if kinds.memory:
        memory = xp.stack([xp.asarray(usual.get(scale, scale)) for scale in kinds.memory])
    absolute = _by_kind(kinds.layout, xp, fine * length, 1.0, speed, speed / length, memory, energy)
    return _Numbers(rtol, fine, length, speed, rtol * relative, ABSOLUTE_SHARE * rtol * absolute)


@cached_jit(what="tolerances")
def _traced_numbers(system: System, rtol) -> _Numbers:
    """The same of numbers that are traced, as one program: under `jax.vmap` each operation would be one, fifty in all,
    which took a tenth of the first call of many runs."""
    return _numbers(system, rtol)


def rounding_floor(system: System) -> Numeric:
    """The relative tolerance below which steps follow rounding, and their number grows without gain.

    A ball's place in its gap is the difference of positions of the length L: it is known to some eps L/c of the
    clearance, and so are the forces. The dry four-bar takes 7,954 steps at 1e-12 and 53,130 at 1e-13, to the same
    digits.
    """
    if not system.force_joints:
        return LEAST_ROUNDING
    length, _, clearance = _scales(system)
    return _rounding_floor(True, length, clearance)


def _rounding_floor(answers_with_force: bool, length: Numeric, clearance: Numeric) -> Numeric:
    if not answers_with_force:
        return LEAST_ROUNDING
    xp: Any = np if is_concrete(length) and is_concrete(clearance) else jnp
    return xp.maximum(ELASTIC_ROUNDING, 3 * ROUNDING * length / clearance)


def _lifted(rtol: Number, floor: Numeric) -> Any:
    if is_concrete(rtol) and is_concrete(floor):
        return max(float(rtol), float(floor))
    return jnp.maximum(rtol, floor)


def length_scale(system: System) -> Numeric:
    """How large the mechanism is, L [m]; see `component_tolerances`."""
    return _scales(system)[0]


def time_scale(system: System) -> Numeric:
    """How long the mechanism takes for its own length at its own speed, L / V [s]; see `component_tolerances`."""
    length, speed, _ = _scales(system)
    return length / speed


def energy_scale(system: System) -> Numeric:
    """The energy that the mechanism has at its own speed, m V^2 [J]; see `component_tolerances`."""
    _, speed, _ = _scales(system)
    return sum(body.mass for body in system.bodies.values()) * speed * speed


def known_speed_and_force(system: System) -> tuple[float, float] | None:
    """V [m/s] and m V^2 / L [N]; None where a number that they are made of is traced. See `component_tolerances`."""
    if not all(map(is_concrete, _measures(system))):
        return None
    length, speed, _ = _scales(system)
    return float(speed), float(energy_scale(system) / length)


def length_and_energy(structure: Structure, theta: Any) -> tuple[Numeric, Numeric]:
    """`length_scale` and `energy_scale` of a system that is taken apart: few operations, however many bodies it has."""
    at = _measured_at(structure)
    if at is None:
        system = structure.system(theta)
        return length_scale(system), energy_scale(system)
    theta = jnp.asarray(theta)
    length, speed = _length_and_speed_of(jnp, [kind.within(theta).reshape(-1, 3) for kind in at.vectors])
    return length, jnp.sum(at.masses.within(theta)) * speed * speed


def _by_kind(
    layout: Layout, xp, position, quaternion, velocity, angular_velocity, memory, work
) -> Float[Array | np.ndarray, " n"]:
    """The flat vector with one number for each kind of component."""
    n = layout.n_bodies
    if xp is np:  # without a dozen small arrays
        flat = np.empty(layout.size)
        q, v = flat[: layout.n_position].reshape(n, -1), flat[layout.n_position : layout.memory_start].reshape(n, -1)
        q[:, :3], q[:, 3:], v[:, :3], v[:, 3:] = position, quaternion, velocity, angular_velocity
        flat[layout.memory_start : layout.work_start], flat[layout.work_start :] = memory, work
        return flat
    q = xp.concatenate([position * xp.ones((n, 3)), quaternion * xp.ones((n, 4))], 1).ravel()
    v = xp.concatenate([velocity * xp.ones((n, 3)), angular_velocity * xp.ones((n, 3))], 1).ravel()
    return xp.concatenate([q, v, memory * xp.ones(layout.n_memory), work * xp.ones(layout.n_work)])


def _scales(system: System):
    """Length [m], speed [m/s] and smallest clearance [m] of a scene; the clearance is infinite where there is none."""
    places, velocities, spins, clearances = _lengths_and_speeds(system)
    xp: Any = jnp if _has_traced_scales(system) else np
    vectors = [xp.stack([xp.asarray(v) for v in each]) for each in (places, velocities, spins, [system.gravity])]
    smallest = _smallest(xp, xp.stack([xp.asarray(c) for c in clearances]) if clearances else np.zeros(0))
    return (*_length_and_speed_of(xp, vectors), smallest)


def _length_and_speed_of(xp: Any, vectors: list) -> tuple:
    """Of arrays of vectors, shape (n, 3): places, velocities, spins, gravity."""
    places, velocities, spins, gravity = vectors

    def largest(vectors):
        return xp.max(xp.sqrt(xp.sum(vectors**2, axis=1)))

    length = xp.maximum(largest(places), SMALLEST_LENGTH)
    speed = xp.sqrt(largest(gravity) * length) + largest(velocities) + largest(spins) * length
    return length, xp.where(speed > 0, speed, 1.0)


def _smallest(xp: Any, clearances: Any) -> Numeric:
    return xp.min(clearances) if clearances.size else np.inf


def _lengths_and_speeds(system: System) -> tuple[list, list, list, list]:
    """Places, velocities and angular velocities, and clearances of a scene."""
    bodies, joints = system.bodies.values(), list(system.joints.values())
    places = [place for joint in joints for place in joint.points]
    models: list[Any] = [getattr(joint, "model", None) for joint in joints]
    return (
        [body.position for body in bodies] + places,
        [body.velocity for body in bodies],
        [body.angular_velocity for body in bodies],
        [model.clearance for model in models if model is not None and model.has_surfaces],
    )


def _has_traced_scales(system: System) -> bool:
    """Whether the scales of a scene hang on a number that is traced."""
    return not all(map(is_concrete, [*itertools.chain(*_lengths_and_speeds(system)), system.gravity]))


def _measures(system: System) -> list:
    """All numbers that tolerances are made of, besides the relative one."""
    scales = [entry.scale for slot in system.all_slots for entry in slot.contents if not isinstance(entry.scale, str)]
    return [
        *itertools.chain(*_lengths_and_speeds(system)),
        system.gravity,
        *(body.mass for body in system.bodies.values()),
        *scales,
    ]


@lru_cache(maxsize=64)
def norm_of_first(n: int) -> Callable:
    """The norm of errors that looks at so many entries of the state: not at the work, whose price is no step.

    Runs with and without an account of the work make the same steps so.
    """

    def norm(y: Float[Array, " size"]) -> Scalar:
        return optimistix.rms_norm(y[:n])

    return norm


def controller_for(structure: Structure, rtol, atol) -> diffrax.PIDController:
    """The step-size control of a run."""
    layout = example_of(structure).layout
    norm = norm_of_first(layout.work_start) if layout.n_work else optimistix.rms_norm
    return diffrax.PIDController(rtol=jnp.asarray(rtol), atol=jnp.asarray(atol), norm=norm)
