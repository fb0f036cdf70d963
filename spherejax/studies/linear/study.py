"""`sj.linearize`: state-space matrices of a mechanism about one of its states."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import shape_of
from spherejax.foundations.terminals import waiting_for
from spherejax.model.numbers import Number, numbers_at
from spherejax.model.scene import Scene
from spherejax.model.system import System
from spherejax.motion.equations.quantities import LETTERS, Quantity, quantity
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.start.redundancy import report_at
from spherejax.motion.start.tolerances import length_scale
from spherejax.studies.linear.coordinates import coordinates_of
from spherejax.studies.linear.following import theta_slope
from spherejax.studies.linear.linear_result import Linearization, LinearizationWarning
from spherejax.studies.linear.point import OperatingPoint, asked_of, point_of
from spherejax.studies.linear.steadiness import steadiness_of

Outputs = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]

NOT_AT_AN_INSTANT = ("penetration", "absorbed_work", "dissipated_energy", "elastic_energy", "mechanical_energy")
"""Kinds of quantities that are made of a whole run, or of several others."""

MOVES_A_CONSTRAINT = 1e-12
"""Derivatives of constraints by an input above this are no rounding."""

KINK_STEP, KINK = 1e-6, 1e-3
"""Length of the steps across which slopes are compared, as a share of the mechanism's, and the least share of a column
of A by which they must differ to count."""

ROUNDING = 1e-13
"""Share of accelerations that is rounding: 500 times that of a number, for sums of forces."""


def linearize(
    what: Scene | Trajectory,
    *,
    at: str | float = "start",
    inputs: Sequence[str] | str = (),
    outputs: Sequence[str] | str = (),
    turning: Any = (0.0, 0.0, 0.0),
    t: float = 0.0,
) -> Linearization:
    """The linear system that small deviations from a state obey: x' = A x + B u, y = C x + D u.

    Any joint, force and driver; redundant constraints too. The coordinates are independent ones, found from the null
    space of the constraints at the levels of positions and velocities, and the memory of joints and forces; every
    derivative is exact (automatic), none a difference. About a motion (a run at a time, a start with velocities) the
    matrices are those of that moment: coefficients that change, in coordinates that are carried along without turning.

    Args:
        what: a scene, or a run.

    Other args:
        at: "start", the assembled start; "rest", the rest position near it (`sj.equilibrium`); or of a run any moment
            [s]: between two samples it is integrated on from the first of them, by the run's method and tolerances.
        inputs: paths of numbers of the scene, e.g. `"forces.push.force.z"`, `"joints.elbow.model.stiffness"`; a vector
            counts as its entries. A number must not move a constraint.
        outputs: quantities, e.g. `"position.rocker.z"`, `"reaction.elbow"`, `"shock.length"`; a vector counts as its
            entries.
        turning: angular velocity of the axes in which deviations are observed [rad/s], world axes. A steady precession
            or rotation of the whole mechanism has constant coefficients in axes that turn with it.
        t: time of the start [s], for drivers, forces and roads that know the time.

    Returns:
        Matrices, `.modes()`, `.frequency_response(f)`, `.to_xarray()`, `.to_control()`; prints what it is.

    Raises:
        SceneError: for a request that makes no sense, an input that moves a constraint, or a singular configuration.

    Warns:
        LinearizationWarning: where the rates have a kink, so that a derivative is right to one side only; for a force
            element that samples, which holds its effort here.
    """
    moment, axes = _finite("t", t, ()), _finite("turning", turning, (3,))
    whole, system = asked_of(what, at)
    numbers = _inputs(whole, inputs)
    outputs_asked = _outputs(system, outputs)
    _warn_of_samples(system)
    with waiting_for("a linearization", program="a linearization"):
        point = point_of(what, at, float(moment))
        return _linearized(point, numbers, outputs_asked, axes)


def _linearized(point: OperatingPoint, numbers: list[Number], outputs: Outputs, axes: np.ndarray) -> Linearization:
    names, labels, units = outputs
    _require_regular(point)
    layout = point.system.layout
    equations = point.equations
    found = equations.geometry
    coordinates = coordinates_of(found, layout.n_memory)
    basis, inverse = coordinates.basis, coordinates.inverse
    rates, values = equations.rates_along(axes, basis), equations.values_along(names, basis)
    _require_finite(rates, point)
    # Entries of memory that nothing changes (a rate that is remembered while a contact lasts), that change nothing, or
    # that only say in which turn an angle is, are no states.
    n_v = 2 * coordinates.degrees_of_freedom
    changes = np.any(rates[2 * layout.n_velocity :] != 0, axis=1)
    acts = np.any(rates[:, n_v:] != 0, axis=0) | np.any(values[:, n_v:] != 0, axis=0)
    counts = [entry.counts_turns for slot in point.system.all_slots for entry in slot.contents]
    keep = np.concatenate([np.ones(n_v, bool), changes & acts & ~np.array(counts, bool)])
    basis_rate = coordinates.turned(found, equations.geometry_rate, axes)
    A, C = (inverse @ (rates - basis_rate))[np.ix_(keep, keep)], values[:, keep]
    B, D = np.zeros((len(A), 0)), np.zeros((len(C), 0))
    if numbers:
        slopes = np.stack([theta_slope(point, number) for number in numbers], 1)
        forced, shown, held = equations.by_numbers(names, slopes)
        _require_free(numbers, held)
        B, D = (inverse @ forced)[keep], shown
    steps, sizes = _steps(point, basis)
    nearby = equations.rates(steps)
    result = Linearization(
        A=A,
        B=B,
        C=C,
        D=D,
        inputs=tuple(number.name for number in numbers),
        outputs=labels,
        output_units=units,
        states=_state_names(point.system, coordinates.degrees_of_freedom, keep),
        basis=basis[:, keep],
        inverse=inverse[keep],
        turning=axes,
        point=point,
        coordinates=coordinates,
        geometry=found,
        kept=keep,
        rates=rates,
        rounding=_rounding(point, inverse, rates, nearby[0], sizes)[np.ix_(keep, keep)],
        steadiness=steadiness_of(point, axes, coordinates, rates, nearby[0]),
    )
    _warn_of_kinks(result, nearby)
    return result


def _warn_of_samples(system: System) -> None:
    """Say that controllers that sample are no part of a linear system in continuous time."""
    if system.sampled_forces:
        names = " and ".join(map(repr, system.sampled_forces))
        warnings.warn(
            f"linearize: force element {names} samples: what it holds between samples is held here, so that A is the "
            "mechanism's with constant efforts, without the controller. Take its twin in continuous time for the loop",
            LinearizationWarning,
            stacklevel=3,
        )


def _finite(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, np.float64) if shape_of(value) == shape else np.array(np.nan)
    if not np.all(np.isfinite(array)):
        wanted = "a finite number" if shape == () else "three finite numbers"
        raise SceneError(f"linearize: {name} = {value!r} must be {wanted}")
    return array


def _inputs(whole: Scene | System, names: Sequence[str] | str) -> list[Number]:
    names = [names] if isinstance(names, str) else list(names)
    try:
        found = [number for name in names for number in numbers_at(whole, name)]
    except SceneError as error:
        raise SceneError(f"linearize: inputs: {error}") from None
    _require_distinct("inputs", [number.name for number in found])
    return found


def _outputs(system: System, names: Sequence[str] | str) -> Outputs:
    """Names of whole quantities, labels of their entries, and units."""
    found = [quantity(name, system) for name in ([names] if isinstance(names, str) else names)]
    for each in found:
        if each.kind in NOT_AT_AN_INSTANT and not each.of_element and not each.of_answer:
            raise SceneError(f"linearize: {each.name!r} cannot be an output: it is no quantity of one instant")
    labels = [label for each in found for label in _labels(each)]
    _require_distinct("outputs", labels)
    units = [each.unit for each in found for _ in _labels(each)]
    return tuple(each.name for each in found), tuple(labels), tuple(units)


def _labels(what: Quantity) -> list[str]:
    return [f"{what.name}.{letter}" for letter in LETTERS[what.dims]] if what.dims else [what.name]


def _require_distinct(what: str, names: list[str]) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise SceneError(f"linearize: {what}= asks for {twice!r} twice")


def _require_regular(point: OperatingPoint) -> None:
    report = report_at(point.system, point.t, point.y)
    if report.is_singular:
        raise SceneError(
            f"linearize: the configuration {point.words} is singular: nearby fewer constraint equations depend on "
            "others, and the mechanism can go on in more than one way. Linearize beside it"
        )


def _require_finite(rates: np.ndarray, point: OperatingPoint) -> None:
    if not np.all(np.isfinite(rates)):
        raise SceneError(f"linearize: derivatives of the equations of motion {point.words} are not finite")


def _require_free(numbers: list[Number], held: np.ndarray) -> None:
    """Refuse inputs that the constraints know: then u' and u'' would act too, which no B holds."""
    for number, column in zip(numbers, held.T, strict=True):
        if np.abs(column).max(initial=0.0) > MOVES_A_CONSTRAINT:
            raise SceneError(
                f"linearize: input {number.name!r} moves a constraint, so that its rates would act as well. Take a "
                "force or a number of a law; what a driver prescribes can act through a stiff bushing or spring instead"
            )


def _state_names(system: System, f: int, keep: np.ndarray) -> tuple[str, ...]:
    memory = [f"{slot.joint}.{name}" for slot in system.all_slots for name in slot.names]
    names = [*(f"x{i + 1}" for i in range(f)), *(f"u{i + 1}" for i in range(f)), *memory]
    return tuple(name for name, kept in zip(names, keep, strict=True) if kept)


def _steps(point: OperatingPoint, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """No change, then small ones along each coordinate, forward and back, both also a tenth as long; their sizes."""
    n_v = point.system.layout.n_velocity
    length = float(np.asarray(length_scale(point.system)))
    scales = np.concatenate([np.tile([length] * 3 + [1.0] * 3, n_v // 3), np.full(len(basis) - 2 * n_v, length)])
    sizes = KINK_STEP / np.max(np.abs(basis) / scales[:, None], axis=0, initial=1e-300)
    steps = [share * sign * (basis * sizes).T for share in (1.0, 0.1) for sign in (1, -1)]
    return np.concatenate([np.zeros((1, len(basis))), *steps]), sizes


def _rounding(
    point: OperatingPoint, inverse: np.ndarray, rates: np.ndarray, now: np.ndarray, sizes: np.ndarray
) -> np.ndarray:
    """What rounding may leave in entries of A.

    Of derivatives that cancel, and of the accelerations at the state and by gravity, which joints take up: by a change
    as large as the mechanism they change by as much as themselves.

    Args:
        point: the state.
        inverse: coordinates by changes.
        rates: derivatives of the rates along coordinates.
        now: rates at the state.
        sizes: of coordinates that move the mechanism by `KINK_STEP`.
    """
    layout = point.system.layout
    falling = np.concatenate([np.abs(np.asarray(point.system.gravity)), np.zeros(3)])
    now = np.abs(now)
    now[: layout.n_velocity] = 0.0
    now[layout.n_velocity : 2 * layout.n_velocity] += np.tile(falling, layout.n_bodies)
    by_state = np.outer(np.abs(inverse) @ now, KINK_STEP / sizes)
    return ROUNDING * (np.abs(inverse) @ np.abs(rates) + by_state)


def _warn_of_kinks(result: Linearization, nearby: np.ndarray) -> None:
    """Compare slopes to both sides at two distances: what differs no less at the smaller one is a kink."""
    _, sizes = _steps(result.point, result.coordinates.basis)
    if not len(sizes):
        return
    nearby = nearby.copy()
    nearby[:, : result.point.system.layout.n_velocity] = 0.0
    reduced = (nearby[1:] - nearby[0]) @ result.inverse.T
    far, back, near, near_back = reduced.reshape(4, len(sizes), -1)
    jumps = [np.linalg.norm(far + back, axis=1) / sizes, np.linalg.norm(near + near_back, axis=1) / (0.1 * sizes)]
    jumps = [jump[result.kept] for jump in jumps]
    columns = np.linalg.norm(result.A, axis=0)
    # What rounding leaves of accelerations that cancel, over the length of the smaller step.
    noise = ROUNDING * np.linalg.norm(np.abs(result.inverse) @ np.abs(nearby[0])) / (0.1 * sizes[result.kept])
    has_kink = (jumps[1] > jumps[0] / 2) & (jumps[1] > KINK * columns + noise)
    if np.any(has_kink):
        names = ", ".join(name for name, kink in zip(result.states, has_kink, strict=True) if kink)
        warnings.warn(
            f"linearize: {result.point.words} the rates have a kink along {names} (friction that reverses, a contact "
            "that just touches): the derivative holds to one side. Linearize beside it, or take a smooth law",
            LinearizationWarning,
            stacklevel=4,
        )
