"""`sj.wear`: what a motion rubs off ball and socket, or journal and bearing, in one cycle and in many."""

import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import enforce, is_concrete
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.legal import non_negative, positive
from spherejax.motion.results.trajectory import Trajectory
from spherejax.physics.joints.journal import PlacedJournal
from spherejax.studies.wear.charts import AbstractChart
from spherejax.studies.wear.contacts import ContactInstants, contacts_of
from spherejax.studies.wear.cycles import Worn, over_cycles
from spherejax.studies.wear.deposit import Maps, rubbed
from spherejax.studies.wear.planes import RubbingCycles, Surface, names_of, surface_of
from spherejax.studies.wear.rubbing import RubbingCycle, conserved, cycle_of, no_wear, require_expected, shape_of
from spherejax.studies.wear.wear_result import Checks, Wear, WearWarning

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
    length: float | None = None,
    cells: int | None = None,
    largest_block: float = 0.05,
) -> Wear:
    """Depth of wear on ball and socket, or on journal and bearing, by Archard's law at every point.

    The run is one cycle, or `window` of it is. It is made once more to see its steps, as for `run.impacts`; what they
    tell of each contact, force, place, velocities, becomes a field of pressure and of sliding on the worn surfaces, and
    its work is added up on two maps, one fixed to each body. Over many cycles the depths change the pressure; they do
    not change the motion, see the limits.

    Args:
        run: a single run that reached its end.
        joint: a spherical or revolute joint with contact (`Dry`, or the contact of `Lubricated`). The socket's side is
            the bearing's, the ball's the journal's. Of a journal that tilts the name that was given to
            `sj.joints.tilting_journal`: its planes wear together.

    Other args:
        k_socket, k_ball: wear coefficients of the socket's and the ball's material [m^2/N], 0 for one that does not
            wear. UHMWPE on cobalt-chromium about 1e-15, dry steel about 1e-13.
        cycles: how many times the motion is repeated.
        window: first and last instant of a cycle [s]; the whole run where None.
        foundation: stiffness k_w of the surfaces [N/m^3], pressure over depth, e.g. of a liner of thickness t
            E (1 - nu)/((1 + nu) (1 - 2 nu) t). None: at each instant as stiff as makes the patch on unworn surfaces as
            wide as Hertz's: of a ball's at the run's penetration, of a journal's at its force, with the law of a
            cylinder; beside a given stiffness, as soft as lets a journal go in as far as the run says.
        length: of a bearing [m]; that of the contact's law where None. Of a journal that tilts its planes say it.
        cells: of each map, along each side of the square on which the sphere is laid out, or around a bearing; chosen
            where None so that a typical patch has four from its middle to its edge, of a bearing sixteen.
        largest_block: by how much a block of cycles may deepen any place, as a share of the clearance.

    Returns:
        Maps, volumes, what was checked; prints as text, `figure()`, `to_xarray()`, `save()`.

    Raises:
        SceneError: for a request that cannot be answered, before anything is computed.
        SimulationError: where a check of conservation fails.

    Limits: the wear of a parallel journal is the same all along its bearing; that of one that tilts is known in its
    planes, and between them by the polynomial through them. The order of c/R is left out. Along the contact's direction
    the pressure carries the run's normal force; what is left across it on worn surfaces is told, not balanced. Force,
    direction and sliding are those of the run for all cycles: once the wear is as deep as a good part of the
    clearance, take `sj.studies.wear_in`, or simulate again with `effective_clearance`. Rubbed off material is gone. The
    numbers are concrete, and the result is not traced: for derivatives by k take differences, one run serves all of
    them.

    Source: Archard (1953); blocks of cycles after Mukras et al. (2009), see `spherejax.studies.wear.cycles`.
    """
    surface = contact_surface(run, joint, length)
    coefficients = check_numbers(joint, k_socket, k_ball, cycles, foundation, largest_block)
    check_cells(joint, cells, surface.kind)
    window = checked_window(run, window)
    cycle = cycles_of(run, surface, coefficients, window, foundation, cells)
    checks = checks_of(cycle)
    states, diagnosis = over_cycles(cycle.rate, cycle.unworn, float(cycles), largest_block * cycle.clearance)
    remarks = [*remarks_on(cycle, checks, diagnosis), *_on_the_motion(cycle, states)]
    found = result_of(run, cycle, states, checks, diagnosis, remarks)
    for text in found.remarks:
        warnings.warn(text, WearWarning, stacklevel=2)
    return found


# What is asked for ----------------------------------------------------------------------------------------------------


def contact_surface(run: Trajectory, joint: str, length: float | None) -> Surface:
    """What wears of a joint, of a run that reached its end."""
    if not isinstance(run, Trajectory):
        raise SceneError(f"wear takes a run, what sj.simulate returns, and not {type(run).__name__}")
    if not is_concrete(run.ys) or np.ndim(run.ys) != 2:
        raise SceneError("wear is of a single run, outside of jit and vmap; take one lane of the batch first")
    known = list(run.system.contact_joints)
    if names_of(joint, known)[0] not in known:
        raise SceneError(f"joint {joint!r} has no contact that could wear; {one_of(known, str(joint))}")
    run.require_success()
    model: Any = run.system.spherical(names_of(joint, known)[0]).model  # planes of a journal that tilts have the same
    if not model.surfaces_touch:
        raise SceneError(
            f"joint {joint!r} has a film that bears the ball beyond the clearance: surfaces never touch and nothing "
            "wears. Run the scene with Dry(...) or the contact of Lubricated(...), e.g. conformity=its liner"
        )
    return surface_of(run.system, joint, length)


def ball_matters(model: Any, k_ball: float) -> bool:
    """Whether it matters where on the ball a patch lies: not on a round one that does not wear."""
    return k_ball > 0 or model.surfaces.ball_depth is not None


def check_numbers(joint, k_socket, k_ball, cycles, foundation, largest_block) -> tuple[float, float]:
    """Both wear coefficients, once all numbers are right."""
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
    return float(k_socket), float(k_ball)


def check_cells(joint: str, cells: Any, kind: type[AbstractChart]) -> None:
    """Whether a number of cells is one of such maps."""
    fewest, most = kind.possible_cells
    is_whole = isinstance(cells, int | np.integer) and not isinstance(cells, bool)
    if cells is not None and not (is_whole and fewest <= cells <= most):
        raise SceneError(
            f"wear of joint {joint!r}: cells = {cells!r} must be a whole number from {fewest} to {most}, or None"
        )


def checked_window(run: Trajectory, window) -> tuple[float, float] | None:
    """First and last instant of a cycle within the run [s]; None for all of it."""
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


def contacts_in(run: Trajectory, surface: Surface, k_ball: float, window, foundation) -> list[ContactInstants]:
    """The contacts of a run's cycle, part by part."""
    contacts = []
    for name, geometry in surface.parts:
        counts = ball_matters(run.system.spherical(name).model, k_ball)
        own = surface.kind, geometry
        contacts.append(contacts_of(run.system, run._steps, name, window, run.scalar, own, foundation, counts))
    return contacts


def cycles_of(run: Trajectory, surface: Surface, coefficients, window, foundation, cells: int | None) -> RubbingCycles:
    """The cycle that a run has told, on maps with as many cells as are asked for, or as resolve a typical patch."""
    contacts = contacts_in(run, surface, coefficients[1], window, foundation)
    chart = surface.kind(_cells_for(surface.kind, contacts, cells))
    parts = []
    for (name, geometry), own in zip(surface.parts, contacts, strict=True):
        model: Any = run.system.spherical(name).model
        parts.append(cycle_of(name, geometry, own, chart, coefficients, shape_of(model, chart)))
    return RubbingCycles(surface.joint, tuple(parts), surface.chart(chart.n), surface.area)


def _cells_for(kind: type[AbstractChart], contacts: list[ContactInstants], cells: int | None) -> int:
    if cells is not None:
        return int(cells)
    if not any(len(own.duration) for own in contacts):
        return kind.usual_cells[0]
    return kind.cells_for(_typical_half_angle(contacts))


def _typical_half_angle(contacts: list[ContactInstants]) -> float:
    """Mean half angle of the patches over the load [rad]."""
    impulse = np.concatenate([np.asarray(own.contact.force) * own.duration for own in contacts])
    half_angle = np.concatenate([own.half_angle for own in contacts])
    return float(impulse @ half_angle / impulse.sum()) if impulse.any() else float(half_angle.mean())


# What is checked ------------------------------------------------------------------------------------------------------


def _elsewhere(work: Maps, other: Maps, coefficients: tuple[float, float]) -> float:
    """Share of the work that lies in other cells, of the sides that wear on the one where that is more."""
    return max(
        float(jnp.sum(jnp.abs(one - two)) / jnp.maximum(2 * jnp.sum(one), np.finfo(float).tiny))
        for one, two, k in zip(work, other, coefficients, strict=True)
        if k > 0
    )


def checks_of(cycle: RubbingCycles) -> Checks:
    """What is checked of a first cycle, on surfaces that are not worn yet; of several contacts the mean over the work.

    Raises:
        SimulationError: where something is not conserved.
    """
    checks = [_checks_of_part(part) for part in cycle.rubbing]
    if not checks:
        return Checks(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.inf, 0, 0)
    if len(checks) == 1:
        return checks[0]
    work = np.array([one.rubbed for one in checks])
    share = work / max(work.sum(), np.finfo(float).tiny)
    return Checks(
        lost=max(one.lost for one in checks),
        unbalanced=max(one.unbalanced for one in checks),
        slid=sum(one.slid for one in checks),
        rubbed=float(work.sum()),
        time_error=float(share @ [one.time_error for one in checks]),
        gathering=float(share @ [one.gathering for one in checks]),
        cells_per_patch=float(share @ [one.cells_per_patch for one in checks]),
        instants=sum(one.instants for one in checks),
        gathered=sum(one.gathered for one in checks),
    )


def _checks_of_part(cycle: RubbingCycle) -> Checks:
    contacts, chart = cycle.contacts, cycle.chart
    work, told = cycle.rubbed(no_wear(chart))
    elsewhere = _elsewhere(work, rubbed(cycle.shape, *contacts.coarser, cycle.geometry, chart)[0], cycle.coefficients)
    lost, unbalanced = conserved(cycle.joint, work, told, contacts)
    require_expected(cycle.joint, float(told.power @ contacts.duration), contacts)
    weights = told.power * contacts.duration
    total = float(weights.sum())
    radius = float(weights @ told.radius) / total if total > 0 else float(np.mean(told.radius))
    width = float(radius / chart.cell_width)
    return Checks(
        lost, unbalanced, contacts.slid, total, contacts.error, elsewhere, width, contacts.looked_at, len(weights)
    )


def remarks_on(cycle: RubbingCycles, checks: Checks, diagnosis: str) -> list[str]:
    """What else should be known of a study, as texts."""
    joint, contacts = cycle.joint, [part.contacts for part in cycle.rubbing]
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
    if contacts and (typical := _typical_half_angle(contacts)) > WIDE:
        remarks.append(
            f"wear of joint {joint!r}: a typical patch reaches {np.degrees(typical):.3g} degrees from its middle, "
            "almost half of all around: the surfaces are soft for their load. Check the unit of foundation=, N/m^3"
        )
    return remarks


def _on_the_motion(cycle: RubbingCycles, states: list[Worn]) -> list[str]:
    """A word where the wear is deep, and the motion would be another."""
    clearance = cycle.clearance
    deepest = max(float(jnp.max(each)) for each in states[-1].depth)
    if deepest <= DEEP * clearance:
        return []
    return [
        f"wear of joint {cycle.joint!r}: it is {deepest:.3g} m deep, {deepest / clearance:.2g} of the clearance, and "
        "the motion is still that of the unworn joint; simulate again with the effective clearance, "
        f"{clearance + states[-1].rate.approach:.4g} m, or let the motion follow: sj.studies.wear_in"
    ]


def result_of(
    run: Trajectory, cycle: RubbingCycles, states, checks: Checks, diagnosis: str, remarks: list[str]
) -> Wear:
    """Everything together."""
    first = cycle.parts[0]
    return Wear(
        joint=cycle.joint,
        bodies=run.system.spherical(first.joint).bodies,
        coefficients=cycle.coefficients,
        clearance=cycle.clearance,
        radius=float(first.geometry.radius),
        chart=cycle.chart,
        area=cycle.area,
        axes=axes_of(run, first.joint),
        span=first.contacts.span,
        states=tuple(states),
        checks=checks,
        diagnosis=diagnosis,
        remarks=tuple(remarks),
    )


def axes_of(run: Trajectory, joint: str) -> tuple[np.ndarray, np.ndarray]:
    """Axes in which the maps of both sides are laid out, in those of their bodies, as columns."""
    placed = run.system.spherical(joint)
    if not isinstance(placed, PlacedJournal):
        return np.eye(3), np.eye(3)
    return np.asarray(placed.frame), np.asarray(placed.frame_on_journal)
