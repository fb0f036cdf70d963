"""`sj.wear`: what a motion rubs off ball and socket, in one cycle and in many."""

import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import enforce, is_concrete
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.legal import non_negative, positive
from spherejax.motion.integration.status import SimulationError
from spherejax.motion.results.trajectory import Trajectory
from spherejax.studies.wear.contacts import CREEPING, ContactInstants, contacts_of
from spherejax.studies.wear.cycles import Rate, over_cycles
from spherejax.studies.wear.deposit import Joint, Maps, Told, rubbed
from spherejax.studies.wear.sphere import cell_solid_angle
from spherejax.studies.wear.wear_result import Checks, Wear, WearWarning

CELLS_PER_PATCH = 4.0
"""Cells from the middle of a patch to its edge, where the number of cells is chosen."""

USUAL_CELLS = (96, 512)
"""Fewest and most along each side of a map, where the number is chosen."""

POSSIBLE_CELLS = (16, 2048)
"""Fewer tell nothing, more take gigabytes."""

LOST = 1e-9
"""What may be missing of the rubbing work on a map, as a share of it: rounding of sums."""

UNBALANCED = 1e-6
"""What the pressure's resultant along the contact's direction may differ from the normal force by, as a share."""

NARROWEST, WIDEST = 0.8, 1.6
"""Rubbing work of patches over that of their resultants: 1 for small patches, 3/2 for a hemisphere pressed along its
axis, less than 1 where it is rubbed across."""

POORLY_INTEGRATED = 0.01
"""Error of the rubbing work by the integration over time, as a share, from which it is warned."""

POORLY_GATHERED = 0.15
"""Share of the rubbing work in other cells, if instants are gathered more coarsely, from which it is warned."""

POORLY_RESOLVED = 1.0
"""Cells from the middle of the mean patch to its edge, below which it is warned."""

WIDE = 1.3
"""Half angle of a typical patch on unworn surfaces [rad] from which it is warned: some 75 degrees."""

DEEP = 0.5
"""Deepest wear as a share of the clearance, from which it is warned that the motion is that of the unworn joint."""


def wear(
    run: Trajectory,
    joint: str,
    *,
    k_socket: float,
    k_ball: float,
    cycles: float = 1.0,
    window: tuple[float, float] | None = None,
    foundation: float | None = None,
    cells: int | None = None,
    largest_block: float = 0.05,
) -> Wear:
    """Depth of wear on ball and socket of a spherical joint, by Archard's law at every point.

    The run is one cycle, or `window` of it is. It is made once more to see its steps, as for `run.impacts`; what they
    tell of each contact, force, place, velocities, becomes a field of pressure and of sliding on the worn surfaces, and
    its work is added up on two maps, one fixed to each body. Over many cycles the depths change the pressure; they do
    not change the motion, see the limits.

    Args:
        run: a single run that reached its end.
        joint: a spherical joint with contact (`Dry`, or the contact of `Lubricated`); journals are refused.

    Other args:
        k_socket, k_ball: wear coefficients of the socket's and the ball's material [m^2/N], 0 for one that does not
            wear. UHMWPE on cobalt-chromium about 1e-15, dry steel about 1e-13.
        cycles: how many times the motion is repeated.
        window: first and last instant of a cycle [s]; the whole run where None.
        foundation: stiffness k_w of the surfaces [N/m^3], pressure over depth, e.g. of a liner of thickness t
            E (1 - nu)/((1 + nu) (1 - 2 nu) t). None: at each instant as stiff as makes the patch on unworn surfaces as
            wide as Hertz's at the run's penetration.
        cells: of each map, along each side of the square on which the sphere is laid out; chosen where None so that a
            typical patch has four from its middle to its edge.
        largest_block: by how much a block of cycles may deepen any place, as a share of the clearance.

    Returns:
        Maps, volumes, what was checked; prints as text, `figure()`, `to_xarray()`, `save()`.

    Raises:
        SceneError: for a request that cannot be answered, before anything is computed.
        SimulationError: where a check of conservation fails.

    Limits: the order of c/R is left out. Along the contact's direction the pressure carries the run's normal force;
    what is left across it on worn surfaces is told, not balanced. Force, direction and sliding are those of the unworn
    joint for all cycles: once the wear is as deep as a good part of the clearance, simulate again with
    `effective_clearance`. Rubbed off material is gone. The numbers are concrete ones, and the result is not traced: for
    derivatives by k take differences, one run serves all of them.

    Source: Archard (1953); blocks of cycles after Mukras et al. (2009), see `spherejax.studies.wear.cycles`.
    """
    model = _contact_model(run, joint)
    _check_numbers(joint, k_socket, k_ball, cycles, foundation, cells, largest_block)
    window = _checked_window(run, window)
    steps = run._steps
    contacts = contacts_of(run.system, steps, joint, window, run.scalar, foundation)
    geometry = Joint(jnp.asarray(float(model.clearance)), jnp.asarray(float(model.socket_radius)))
    n = _cells_for(contacts) if cells is None else int(cells)
    area = float(geometry.radius) ** 2 * cell_solid_angle(n)
    nothing = Maps(jnp.zeros(n * n), jnp.zeros(n * n))
    if not len(contacts.duration):
        states, diagnosis = over_cycles(lambda _: Rate(nothing, 0.0, 0.0), nothing, float(cycles), 1.0)
        checks = Checks(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.inf, 0, 0)
        return _result(run, joint, model, (k_socket, k_ball), contacts, n, states, diagnosis, checks)
    work, first = rubbed(nothing, contacts.contact, contacts.duration, geometry, n)
    elsewhere = _elsewhere(work, rubbed(nothing, *contacts.coarser, geometry, n)[0])
    checks = _checks(joint, work, first, contacts, n, elsewhere)
    coefficients = k_socket, k_ball

    def rate(depth: Maps) -> Rate:
        rubbing, told = rubbed(depth, contacts.contact, contacts.duration, geometry, n)
        _conserved(joint, rubbing, told, contacts)
        each = Maps(*(k / area * w for k, w in zip(coefficients, rubbing, strict=True)))
        weights = told.power * contacts.duration
        total = max(float(weights.sum()), np.finfo(float).tiny)
        farther = float(weights @ (told.approach - first.approach)) / total
        return Rate(each, farther, float(weights @ told.aside) / total)

    states, diagnosis = over_cycles(rate, nothing, float(cycles), largest_block * float(model.clearance))
    found = _result(run, joint, model, coefficients, contacts, n, states, diagnosis, checks)
    for text in found.remarks:
        warnings.warn(text, WearWarning, stacklevel=2)
    return found


# What is asked for ----------------------------------------------------------------------------------------------------


def _contact_model(run: Trajectory, joint: str) -> Any:
    if not isinstance(run, Trajectory):
        raise SceneError(f"wear takes a run, what sj.simulate returns, and not {type(run).__name__}")
    if not is_concrete(run.ys) or np.ndim(run.ys) != 2:
        raise SceneError("wear is of a single run, outside of jit and vmap; take one lane of the batch first")
    if joint not in run.system.contact_joints:
        known = list(run.system.contact_joints)
        raise SceneError(f"joint {joint!r} has no contact that could wear; {one_of(known, str(joint))}")
    if not run.system.spherical(joint).is_ball:
        raise SceneError(
            f"joint {joint!r} is a journal in its bearing: maps of wear are those of a ball and its socket. What "
            "Archard's law rubs off in all is k times the integral of normal_force |sliding_velocity| over time"
        )
    model: Any = run.system.spherical(joint).model
    if not model.surfaces.are_round:
        raise SceneError(f"joint {joint!r} has surfaces that are not round: wear of those is not known here")
    run.require_success()
    return model


def _check_numbers(joint, k_socket, k_ball, cycles, foundation, cells, largest_block) -> None:
    for name, value in (("k_socket", k_socket), ("k_ball", k_ball), ("cycles", cycles), ("foundation", foundation),
                        ("largest_block", largest_block)):  # fmt: skip
        if value is None and name == "foundation":
            continue
        if isinstance(value, bool | str) or value is None or not is_concrete(value) or np.ndim(value) != 0:
            raise SceneError(f"wear of joint {joint!r}: {name} = {value!r} must be a number")
    needed = [
        non_negative("k_socket", k_socket, "m^2/N"),
        non_negative("k_ball", k_ball, "m^2/N"),
        positive("cycles", cycles, "1"),
        positive("largest_block", largest_block, "1"),
    ]
    if foundation is not None:
        needed.append(positive("foundation", foundation, "N/m^3"))
    enforce(f"wear of joint {joint!r}", needed)
    if k_socket == 0 and k_ball == 0:
        raise SceneError(f"wear of joint {joint!r}: k_socket and k_ball are both 0, so nothing wears; give one of them")
    if max(k_socket, k_ball) > 1e-9:
        raise SceneError(
            f"wear of joint {joint!r}: a wear coefficient of {max(k_socket, k_ball):.3g} m^2/N is not one of a solid; "
            "tables in mm^3/(N m) are to be multiplied by 1e-9"
        )
    is_whole = isinstance(cells, int | np.integer) and not isinstance(cells, bool)
    if cells is not None and not (is_whole and POSSIBLE_CELLS[0] <= cells <= POSSIBLE_CELLS[1]):
        raise SceneError(
            f"wear of joint {joint!r}: cells = {cells!r} must be a whole number from {POSSIBLE_CELLS[0]} to "
            f"{POSSIBLE_CELLS[1]}, or None"
        )


def _checked_window(run: Trajectory, window) -> tuple[float, float] | None:
    if window is None:
        return None
    t0, t1 = float(run.ts[0]), float(run.ts[-1])
    try:
        first, last = (float(t) for t in window)
    except (TypeError, ValueError) as error:
        raise SceneError(f"window = {window!r} must be two instants [s], e.g. ({t0:.6g}, {t1:.6g})") from error
    if not t0 <= first < last <= t1:
        raise SceneError(f"window = ({first:.6g}, {last:.6g}) must lie within the run, from {t0:.6g} to {t1:.6g} s")
    return first, last


def _cells_for(contacts: ContactInstants) -> int:
    """As many as give a typical patch, the mean over the load, `CELLS_PER_PATCH` from its middle to its edge."""
    if not len(contacts.duration):
        return USUAL_CELLS[0]
    needed = CELLS_PER_PATCH * np.sqrt(4 * np.pi) / _typical_half_angle(contacts)
    return int(np.clip(16 * np.ceil(needed / 16), *USUAL_CELLS))


def _typical_half_angle(contacts: ContactInstants) -> float:
    """Mean half angle of the patches over the load [rad]."""
    impulse = np.asarray(contacts.contact.force) * contacts.duration
    return float(impulse @ contacts.half_angle / impulse.sum()) if impulse.any() else float(contacts.half_angle.mean())


# What is checked ------------------------------------------------------------------------------------------------------


def _conserved(joint: str, rubbing: Maps, told: Told, contacts: ContactInstants) -> tuple[float, float]:
    """Shares by which a map's work and the resultants of the pressure are off; raises where that is too much."""
    total = float(told.power @ contacts.duration)
    scale = max(total, np.finfo(float).tiny)
    lost = max(abs(float(jnp.sum(each)) - total) / scale for each in rubbing) if total > 0 else 0.0
    unbalanced = float(np.max(np.abs(told.balance)))
    if not (lost <= LOST and unbalanced <= UNBALANCED):
        raise SimulationError(
            f"wear of joint {joint!r} is not conserved: the maps miss {lost:.1e} of the rubbing work ({LOST:.0e} is "
            f"allowed), and the pressure's resultant differs from the normal force by {unbalanced:.1e} of it "
            f"({UNBALANCED:.0e}). This is a fault of the program, or of numbers beyond its range; please report it"
        )
    return lost, unbalanced


def _require_expected(joint: str, rubbing: float, contacts: ContactInstants) -> None:
    """Whether those that stand for alike instants rub as much as all instants do."""
    slow = CREEPING * float(np.asarray(contacts.contact.force) @ contacts.duration)
    if contacts.expected > slow and not NARROWEST < rubbing / contacts.expected < WIDEST:
        raise SimulationError(
            f"wear of joint {joint!r}: patches that stand for alike instants rub {rubbing:.4g} J, and all instants "
            f"{contacts.expected:.4g} J. This is a fault of the program; please report it, with the scene"
        )


def _elsewhere(work: Maps, other: Maps) -> float:
    """Share of the work that lies in other cells, on the map where that is more."""
    return max(
        float(jnp.sum(jnp.abs(one - two)) / jnp.maximum(2 * jnp.sum(one), np.finfo(float).tiny))
        for one, two in zip(work, other, strict=True)
    )


def _checks(joint: str, work: Maps, told: Told, contacts: ContactInstants, n: int, elsewhere: float) -> Checks:
    lost, unbalanced = _conserved(joint, work, told, contacts)
    _require_expected(joint, float(told.power @ contacts.duration), contacts)
    weights = told.power * contacts.duration
    total = float(weights.sum())
    radius = float(weights @ told.radius) / total if total > 0 else float(np.mean(told.radius))
    cells = float(radius / np.sqrt(cell_solid_angle(n)))
    return Checks(
        lost, unbalanced, contacts.slid, total, contacts.error, elsewhere, cells, contacts.looked_at, len(weights)
    )


def _result(run, joint, model, coefficients, contacts: ContactInstants, n: int, states, diagnosis: str, checks) -> Wear:
    placed = run.system.spherical(joint)
    remarks = []
    if diagnosis:
        remarks.append(f"wear of joint {joint!r}: {diagnosis}")
    if checks.time_error > POORLY_INTEGRATED:
        remarks.append(
            f"wear of joint {joint!r}: the rubbing work is known to {100 * checks.time_error:.2g} % alone, for the "
            "steps of the run are long against the contacts; simulate with a smaller rtol"
        )
    if checks.gathering > POORLY_GATHERED:
        remarks.append(
            f"wear of joint {joint!r}: {100 * checks.gathering:.2g} % of the rubbing work lie in other cells if alike "
            "instants are gathered more coarsely; volumes are right, depths are known as well as that. Simulate with a "
            "smaller rtol, or ask for fewer cells"
        )
    if checks.cells_per_patch < POORLY_RESOLVED:
        remarks.append(
            f"wear of joint {joint!r}: a typical patch is {checks.cells_per_patch:.2g} cells from its middle to its "
            "edge; volumes are right, depths are means over what cells cover. Ask for more cells"
        )
    if len(contacts.duration) and (typical := _typical_half_angle(contacts)) > WIDE:
        remarks.append(
            f"wear of joint {joint!r}: a typical patch reaches {np.degrees(typical):.3g} degrees from its middle, "
            "almost a hemisphere: the surfaces are soft for their load. Check the unit of foundation=, N/m^3"
        )
    clearance = float(model.clearance)
    deepest = max(float(jnp.max(each)) for each in states[-1].depth)
    if deepest > DEEP * clearance:
        remarks.append(
            f"wear of joint {joint!r}: it is {deepest:.3g} m deep, {deepest / clearance:.2g} of the clearance, and the "
            "motion is still that of the unworn joint; simulate again with the effective clearance, "
            f"{clearance + states[-1].rate.approach:.4g} m"
        )
    return Wear(
        joint=joint,
        bodies=placed.bodies,
        coefficients=coefficients,
        clearance=clearance,
        radius=float(model.socket_radius),
        cells=n,
        span=contacts.span,
        states=tuple(states),
        checks=checks,
        diagnosis=diagnosis,
        remarks=tuple(remarks),
    )
