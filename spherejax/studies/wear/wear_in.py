"""`sj.studies.wear_in`: wear over many cycles, with a motion that follows the worn surfaces.

A block of dN cycles is made twice. With the contacts A of a cycle on the surfaces as they are it leads to depths h_A;
a cycle that is simulated on those has contacts B; and the block with half of each leads to h_B:

    h_A = h + dN r_A,    h_B = h + dN (r_A + r_B)/2,

where the pressure follows the wear within a block as in `sj.wear`, by shorter steps. Their largest difference is the
error of the block; a block whose error is too large is made again, shorter. This is Heun's method for the motion
around Heun's method for the pressure.
"""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import enforce, is_concrete
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.forms import whole_number
from spherejax.foundations.legal import positive
from spherejax.model.scene import Scene
from spherejax.motion.integration.status import SimulationError
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.simulate import simulate
from spherejax.physics.joints.dry import Dry
from spherejax.physics.joints.rim import Rim
from spherejax.physics.joints.spherical import Spherical
from spherejax.studies.progress import telling
from spherejax.studies.wear.charts import AbstractChart, CircleChart, SphereChart
from spherejax.studies.wear.contacts import ContactInstants
from spherejax.studies.wear.cycles import Rate, Worn, over_cycles
from spherejax.studies.wear.deposit import Maps
from spherejax.studies.wear.gap import Profiles, fitted, misfit
from spherejax.studies.wear.planes import RubbingCycles, Surface, names_of, rim_alone
from spherejax.studies.wear.rubbing import LOST, RubbingCycle, cycle_of
from spherejax.studies.wear.study import (
    check_cells,
    check_numbers,
    checked_window,
    checks_of,
    contact_surface,
    contacts_in,
    cycles_of,
    remarks_on,
    result_of,
)
from spherejax.studies.wear.wear_in_result import WearBlock, WearIn
from spherejax.studies.wear.wear_result import WearWarning

MOST_TRIES = 200
"""Blocks that are tried, those that are made again counted."""

MOST_FAILURES = 3
"""Blocks in a row of which a run fails, each half as long as the one before."""

LARGEST_SHARE = 0.25
"""Of all cycles, of a block: so that curves along the cycles show how they bend."""

SHORTEST, LONGEST = 0.2, 2.0
"""By which factors a block may become shorter or longer than the one before."""

NEGLIGIBLE = 1e-6
"""Depth of wear as a share of the clearance, below which the error of a block is judged by this."""

ILL_FITTED = 0.1
"""Misfit of the profiles, as a share of how far the ball goes for the wear, from which it is warned."""


def wear_in(
    scene: Scene,
    joint: str,
    ts: Any,
    *,
    k_socket: float,
    k_ball: float,
    cycles: float,
    window: tuple[float, float] | None = None,
    foundation: float | None = None,
    length: float | None = None,
    cells: int | None = None,
    degree: int | None = None,
    tolerance: float = 0.02,
    largest_block: float = 0.05,
    progress: bool | Callable[[str], None] = True,
    **options: Any,
) -> WearIn:
    """Wear of a joint over many cycles, by Archard's law, with a motion that follows the worn surfaces.

    The cycle is simulated, its wear is extrapolated over a block of cycles, and the surfaces that it leaves are the
    joint's gap in the next cycle that is simulated: `socket_depth` and `ball_depth` of `Dry`, as harmonics that are
    fitted to how much farther the ball goes on the maps of depth. Of a journal in its bearing the same around the axis.

    Args:
        scene: what is simulated.
        joint: a spherical or revolute joint with a `Dry` model; of a journal that tilts the name that was given to
            `sj.joints.tilting_journal`. Each of its planes has a profile of its own, and the bearing alone wears.
        ts: sample times of a run [s]: from the start of the scene to the end of a cycle.

    Other args:
        k_socket, k_ball: wear coefficients of the socket's and the ball's material [m^2/N], 0 for one that does not
            wear.
        cycles: how many times the motion is repeated.
        window: first and last instant of the cycle [s]; the whole run where None. Leave out how the motion settles: on
            worn surfaces the scene starts as it is described.
        foundation: stiffness of the surfaces [N/m^3], as for `sj.wear`; None: matched to Hertz's.
        length: of a bearing [m], as for `sj.wear`; that of the contact's law where None.
        cells: of each map along each side, or around, as for `sj.wear`; chosen where None.
        degree: L of the harmonics that the motion feels: they resolve 180/L degrees; 8 of a ball, 16 of a journal where
            None.
        tolerance: largest error of a block, as a share of the deepest wear at its end, or of a millionth of the
            clearance where no wear is as deep.
        largest_block: by how much a step within a block may deepen any place, as a share of the clearance.
        progress: shown in terminals and notebooks and not in logs (True), not at all (False), or a function that is
            called with a line of text. A block takes two runs and more; a hip of a million cycles takes minutes.
        options: of `sj.simulate`.

    Returns:
        Maps, volumes, profiles and errors along the cycles, the worn scene, and its run; prints as text.

    Raises:
        SceneError: for a request that cannot be answered, before anything is computed.
        SimulationError: where a check of conservation fails, or a run fails at the start.

    Limits: those of `sj.wear` but for the motion. Profiles are smooth: the ball goes as far as on the maps on the mean,
    and `misfit` says how far it is off. Their stiffness is that of mean radii, see `Dry`. Each cycle starts where the
    scene does. Numbers are concrete, and the result is not traced.
    """
    coefficients = check_numbers(joint, k_socket, k_ball, cycles, foundation, largest_block)
    names = names_of(joint, getattr(scene, "joints", ()))
    kind = _check(scene, joint, names, k_ball, degree, tolerance)
    check_cells(joint, cells, kind)
    degree = kind.degree if degree is None else degree
    study = _WearStudy(scene, names, ts, window, foundation, kind, degree, coefficients[1], options)
    with telling(progress, "wear") as tell:
        tell("the first cycle")
        run = study.run_on(None)
        surface = contact_surface(run, joint, length)
        cycle = cycles_of(run, surface, coefficients, checked_window(run, window), foundation, cells)
        if not cycle.rubbing:
            raise SceneError(f"joint {joint!r}: nothing rubs in the cycle, so nothing wears; choose another window=")
        checks = checks_of(cycle)
        here = Worn(0.0, cycle.unworn, cycle.rate(cycle.unworn))
        profiles = (Profiles(None, None),) * len(names)
        states, blocks = [here], [WearBlock(None, None, 0.0, 0.0, *_of_motion(cycle))]
        largest_step = largest_block * cycle.clearance
        block, diagnosis, failures = LARGEST_SHARE * cycles, "", 0
        for tries in range(MOST_TRIES + 1):
            if here.cycles >= cycles:
                break
            if tries == MOST_TRIES:
                diagnosis = (
                    f"after {MOST_TRIES} blocks {here.cycles:.6g} of {cycles:.6g} cycles were reached, the last in "
                    f"blocks of {block:.3g}: ask for fewer cycles, or for a larger tolerance="
                )
                break
            left = cycles - here.cycles
            # Four quarters are all: rounding leaves no sliver behind.
            block = left if left < block * (1 + 1e-9) else block
            tell(f"{here.cycles:.4g} of {cycles:.4g} cycles, a block of {block:.3g}")
            try:
                tried = _block(study, surface, cycle, here, profiles, block, largest_step)
            except _StoppedError as failure:
                failures += 1
                if failures > MOST_FAILURES:
                    diagnosis = f"after {here.cycles:.6g} of {cycles:.6g} cycles a block failed: {failure}"
                    break
                block *= 0.5
                continue
            failures = 0
            if tried.error > tolerance:
                block *= max(SHORTEST, 0.8 * np.sqrt(tolerance / tried.error))
                continue
            at = cycles if block == left else here.cycles + block
            here = tried.worn._replace(cycles=at)
            _require_kept(cycle, here)
            cycle, run, profiles = tried.cycle, tried.run, tried.profiles
            states.append(here)
            blocks.append(tried.told)
            longer = min(LONGEST, 0.8 * np.sqrt(tolerance / max(tried.error, 1e-6)))
            block = min(block * longer, LARGEST_SHARE * cycles)
    remarks = [*remarks_on(cycle, checks, diagnosis), *_on_the_fit(cycle, here, blocks)]
    maps = result_of(run, cycle, states, checks, diagnosis, remarks)
    for text in remarks:
        warnings.warn(text, WearWarning, stacklevel=2)
    return WearIn(maps, tuple(blocks), int(degree), study.scene_with(profiles), run)


# A block --------------------------------------------------------------------------------------------------------------


class _StoppedError(Exception):
    """A run on worn surfaces failed."""


class _WearStudy(NamedTuple):
    """The scene with its joint, or the planes of its journal, and how it is simulated."""

    scene: Scene
    names: tuple[str, ...]
    ts: Any
    window: Any
    foundation: float | None
    kind: type[AbstractChart]
    degree: int
    k_ball: float
    options: dict[str, Any]

    def scene_with(self, profiles: tuple[Profiles, ...] | None) -> Scene:
        """The scene with profiles in place of its joint's depths; what has none, and all with None, as it is."""
        scene = self.scene
        for name, own in zip(self.names, profiles or (), strict=False):
            if own.socket is None and own.ball is None:
                continue
            depths = [None if a is None else self.kind.profile(a) for a in own]

            def depths_of(scene, name=name):
                model = scene.joints[name].model
                return [model.socket_depth, model.ball_depth]

            scene = eqx.tree_at(depths_of, scene, depths, is_leaf=lambda leaf: leaf is None)
        return scene

    def run_on(self, profiles: tuple[Profiles, ...] | None) -> Trajectory:
        """A run on surfaces with these profiles."""
        return simulate(self.scene_with(profiles), self.ts, **self.options)

    def cycle(self, run: Trajectory, surface: Surface, before: RubbingCycles) -> RubbingCycles:
        """The cycle of a run, on the maps of the one before."""
        contacts = contacts_in(run, surface, self.k_ball, checked_window(run, self.window), self.foundation)
        parts = [_with_contacts(part, own) for part, own in zip(before.parts, contacts, strict=True)]
        return before._replace(parts=tuple(parts))


def _with_contacts(part: RubbingCycle, contacts: ContactInstants) -> RubbingCycle:
    return cycle_of(part.joint, part.geometry, contacts, part.chart, part.coefficients, part.shape)


class _TriedBlock(NamedTuple):
    """A block that was made, with the cycle that is simulated at its end."""

    worn: Worn
    cycle: RubbingCycles
    run: Trajectory
    profiles: tuple[Profiles, ...]
    error: float
    told: WearBlock


def _block(
    study: _WearStudy,
    surface: Surface,
    cycle: RubbingCycles,
    here: Worn,
    profiles: tuple[Profiles, ...],
    block: float,
    largest_step: float,
) -> _TriedBlock:
    first = _extrapolated(cycle.rate, here.depth, block, largest_step)
    after, _, between = _simulated(study, surface, (cycle, cycle), first.depth, profiles)

    def mean_rate(depth: Maps) -> Rate:
        return _mean(cycle.rate(depth), after.rate(depth))

    second = _extrapolated(mean_rate, here.depth, block, largest_step)
    apart = max(float(jnp.max(jnp.abs(a - b))) for a, b in zip(first.depth, second.depth, strict=True))
    # Wear of a millionth of the clearance changes no motion; where next to nothing rubs, depths are rounding.
    deepest = max(float(jnp.max(each)) for each in second.depth)
    error = apart / max(deepest, NEGLIGIBLE * cycle.clearance)
    end, run, profiles = _simulated(study, surface, (after, cycle), second.depth, between)
    volume = here.volume[0] + second.volume[0], here.volume[1] + second.volume[1]
    worn = Worn(0.0, second.depth, end.rate(second.depth), volume)
    # How well the profiles serve is asked of the contacts that they have led to.
    told = WearBlock(*_told_of(profiles), _misfit(end, second.depth, profiles), error, *_of_motion(end))
    return _TriedBlock(worn, end, run, profiles, error, told)


def _extrapolated(rate, depth: Maps, block: float, largest_step: float) -> Worn:
    states, diagnosis = over_cycles(rate, depth, block, largest_step)
    if diagnosis:
        raise _StoppedError(diagnosis)
    return states[-1]


def _mean(one: Rate, other: Rate) -> Rate:
    depth = Maps(*(0.5 * (a + b) for a, b in zip(one.depth, other.depth, strict=True)))
    socket, ball = (0.5 * (a + b) for a, b in zip(one.volume, other.volume, strict=True))
    return Rate(depth, 0.5 * (one.approach + other.approach), 0.5 * (one.aside + other.aside), (socket, ball))


def _simulated(
    study: _WearStudy,
    surface: Surface,
    cycles: tuple[RubbingCycles, RubbingCycles],
    depth: Maps,
    profiles: tuple[Profiles, ...],
) -> tuple[RubbingCycles, Trajectory, tuple[Profiles, ...]]:
    """The cycle on worn surfaces; where the surfaces meet, and how loaded, says the cycle before.

    A plane that touches in the first of `cycles` no more is fitted by the second; one that touches in neither keeps its
    profile, for it has not worn.
    """
    last, earlier = cycles
    maps, fresh = last.split(depth), []
    for one, other, own, old in zip(last.parts, earlier.parts, maps, profiles, strict=True):
        by = one if len(one.contacts.duration) else other
        touches = len(by.contacts.duration) > 0
        fresh.append(fitted(by, own, by.rubbed(own)[1], study.degree) if touches else old)
    profiles = tuple(fresh)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = study.run_on(profiles)
        if not run.succeeded:
            raise _StoppedError(run.diagnosis)
        after = study.cycle(run, surface, last)
    except SceneError as error:
        raise _StoppedError(str(error)) from error
    if not after.rubbing:
        raise _StoppedError("nothing rubs in the cycle any more")
    return after, run, profiles


def _misfit(cycle: RubbingCycles, depth: Maps, profiles: tuple[Profiles, ...]) -> float:
    """Of all parts, by their rubbing work [m]."""
    work, squares = 0.0, 0.0
    for part, own, profile in zip(cycle.parts, cycle.split(depth), profiles, strict=True):
        if not len(part.contacts.duration):
            continue
        told = part.rubbed(own)[1]
        share = float(told.power @ part.contacts.duration)
        work, squares = work + share, squares + share * misfit(part, told, profile) ** 2
    return float(np.sqrt(squares / max(work, np.finfo(float).tiny)))


def _told_of(profiles: tuple[Profiles, ...]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Coefficients of both sides: in a row, or by plane of a journal that tilts, where round planes have zeros."""
    if len(profiles) == 1:
        return profiles[0]
    sides = []
    for rows in zip(*profiles, strict=True):
        size = max((len(row) for row in rows if row is not None), default=0)
        sides.append(np.stack([np.zeros(size) if row is None else row for row in rows]) if size else None)
    return sides[0], sides[1]


def _of_motion(cycle: RubbingCycles) -> tuple[float, float]:
    """Impulse of the normal force in a cycle [N s], and work of the sliding in the contacts' middles [J]."""
    contacts = [part.contacts for part in cycle.parts]
    return sum(own.impulse for own in contacts), sum(own.slid for own in contacts)


# What is asked for, and what is checked -------------------------------------------------------------------------------


def _check(scene: Any, joint: Any, names: tuple[str, ...], k_ball, degree: Any, tolerance: Any) -> type[AbstractChart]:
    """What can be answered before anything is simulated; the kind of the joint's maps."""
    if not isinstance(scene, Scene):
        raise SceneError(f"wear_in takes a scene, which it simulates again and again, and not {type(scene).__name__}")
    if names[0] not in list(scene.joints):
        raise SceneError(f"there is no joint {joint!r}; {one_of(list(scene.joints), str(joint))}")
    for name in names:
        model = getattr(scene.joints[name], "model", None)
        if not isinstance(model, Dry):
            raise SceneError(
                f"joint {name!r}: its model is {type(model).__name__}, and surfaces that wear in the motion are those "
                "of Dry; for the contact of a lubricated joint take sj.wear"
            )
    if isinstance(scene.joints[names[0]], Rim) and names == (joint,):
        raise SceneError(rim_alone(joint))
    if isinstance(scene.joints[names[0]], Rim) and k_ball > 0:
        raise SceneError(
            f"wear of joint {joint!r}: k_ball = {k_ball!r} m^2/N, and a journal that tilts has no motion here once it "
            "is not round. Give k_ball=0.0, or take sj.wear, which tells how much the journal loses"
        )
    kind = SphereChart if isinstance(scene.joints[names[0]], Spherical) else CircleChart
    if degree is not None:
        whole_number("degree", degree, "Give the degree of the harmonics, e.g. degree=8.")
        if degree > kind.largest_degree:
            raise SceneError(f"degree = {degree} must be at most {kind.largest_degree}")
    if isinstance(tolerance, bool | str) or not is_concrete(tolerance) or np.ndim(tolerance) != 0:
        raise SceneError(f"wear of joint {joint!r}: tolerance = {tolerance!r} must be a number")
    enforce(f"wear of joint {joint!r}", [positive("tolerance", tolerance, "1")])
    return kind


def _require_kept(cycle: RubbingCycles, worn: Worn) -> None:
    """Whether the maps hold all that was rubbed off since the start."""
    for each, volume in zip(worn.depth, worn.volume, strict=True):
        there = cycle.chart.total(each) * cycle.area
        if not abs(there - volume) <= LOST * volume:
            raise SimulationError(
                f"wear of joint {cycle.joint!r} is not conserved: {volume:.12g} m^3 were rubbed off, and the maps hold "
                f"{there:.12g} m^3. This is a fault of the program; please report it"
            )


def _on_the_fit(cycle: RubbingCycles, worn: Worn, blocks: list[WearBlock]) -> list[str]:
    far = abs(worn.rate.approach)
    off = blocks[-1].misfit
    if off <= max(ILL_FITTED * far, NEGLIGIBLE * cycle.clearance):
        return []
    return [
        f"wear of joint {cycle.joint!r}: the profiles that the motion feels are off by {off:.3g} m in the contacts, "
        f"where the ball goes {far:.3g} m farther for the wear. Ask for a higher degree="
    ]
