"""Reports of runs, of many runs side by side, and of scenes."""

import platform
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version

import jax
import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.model.system import System
from spherejax.motion.equations.quantities import quantity
from spherejax.motion.integration.audit import CHECKS, NOT_MADE, WARNINGS, cautions, texts_for
from spherejax.motion.integration.status import Status
from spherejax.motion.results.impacts import peaks
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.start.start_now import start_changes
from spherejax.output.citations import cite
from spherejax.output.drawing import draw
from spherejax.output.plot.energy_parts import energy_by_part as draw_energy_by_part
from spherejax.output.plot.energy_parts import energy_unit
from spherejax.output.plot.run_figures import figures_of_run
from spherejax.output.report.motion import viewed
from spherejax.output.report.numbers import numbers_of
from spherejax.output.report.page import Page, PageMotion, PagePicture, PageTable, PageText, pairs

PACKAGES = ("spherejax", "jax", "jaxlib", "diffrax", "equinox", "optimistix", "lineax", "numpy", "scipy")

WHAT_IS_AUDITED = {
    "energy": "energy rises by no more than was put in",
    "loss": "energy does not vanish: it is conserved, or constraint forces do no work where parts dissipate",
    "flight": "no ball is outside its socket without contact",
    "constraints": "the joints' equations hold",
    "quaternions": "quaternions keep their norm",
    "conformity": "surfaces are pressed in within the range of their elastic law",
    "tilt": "journals tilt in their rims by little",
    "rotations": "bushings are turned by no more than their laws measure",
    "turns": "how often angles have gone round is not in doubt",
    "axes": "axes that angles are about tilt by little enough for an angle",
    "film": "the offset of each film is small against its clearance",
    "film_range": "films on liners, and of oil that thickens, are within what their equations are for",
}


def page_of_run(run: Trajectory, title: str, scene: Scene | None) -> Page:
    """The report of a run, or of lanes.

    Raises:
        SceneError: for a traced run.
    """
    if not is_concrete(run.ended):
        raise SceneError("a traced run cannot be reported; report it outside of jit, vmap and grad")
    if np.ndim(run.ended):
        return _page_of_lanes(run, title, scene)
    page = Page(title or f"Motion of {', '.join(run.system.bodies)}", _verdict(run))
    if not bool(run.succeeded):
        page.failed += run.diagnosis.splitlines()
    page.cautions += cautions_of(run)
    add_motion(page, {"": run}, scene)
    page.add("The run", pairs(_summary(run)), _audit(run))
    with _heard(page):
        add_run(page, run)
    add_sources(page, scene or run, run)
    return page


def page_of_scene(scene: Scene, title: str) -> Page:
    """The report of a scene that was not simulated."""
    page = Page(
        title or f"Mechanism of {', '.join(scene.bodies)}", "Not simulated: a mechanism at its assembled start."
    )
    page.add(
        "The mechanism",
        PageMotion([viewed(scene, "")]),
        PagePicture(draw(scene), "the mechanism at its assembled start"),
    )
    add_sources(page, scene)
    return page


def _verdict(run: Trajectory) -> str:
    first, last = (float(run.ts[i]) for i in (0, -1))
    if bool(run.succeeded):
        return f"Succeeded: the run reached its end, {first:.9g} s to {last:.9g} s; its audit is below."
    name = Status(int(run.ended)).name.lower().replace("_", " ")
    return f"FAILED ({name}): the run stopped at t = {float(run.t_reached):.9g} s of {last:.9g} s."


def cautions_of(run: Trajectory) -> list[str]:
    """What a run of any outcome is to be read with; first what its start has changed of the scene."""
    shares = np.asarray(run.stats.audit)
    found = [*start_changes(run.system, run.ts, run.assembly), cautions(shares, texts=texts_for(run.system))]
    if shares[CHECKS.index("energy")] == NOT_MADE:
        found.append("Energy was not audited: the method knows too coarsely what drivers, forces or bristles put in.")
    if run.undetermined_reactions:
        names = ", ".join(run.undetermined_reactions)
        found.append(
            f"Reactions of joints {names} are not unique: their constraint equations depend on each other. The motion "
            "is unique; the share of each of these joints is one of many possible answers."
        )
    return [each for each in found if each]


@contextmanager
def _heard(page: Page) -> Iterator[None]:
    """Warnings given meanwhile become cautions of the page, each once."""
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always", UserWarning)
        yield
    page.cautions += list(dict.fromkeys(str(one.message) for one in given if issubclass(one.category, UserWarning)))


def add_motion(page: Page, runs: dict[str, Trajectory], scene: Scene | None = None) -> None:
    """The mechanism in space, of one run or several to choose from, and a picture of the first with its key."""
    shown, left = [], []
    for name, run in runs.items():
        try:
            shown.append(viewed(run, name, scene=scene, share=len(runs)))
        except SceneError as error:
            left.append(f"{name}: {error}" if name else f"No picture of the mechanism: {error}")
    if not shown:
        page.add("The mechanism", PageText(left))
        return
    drawn = next(run for name, run in runs.items() if name == shown[0]["name"])
    picture = PagePicture(draw(drawn, scene=scene), "the mechanism at the start, with the key of its symbols")
    page.add("The mechanism", PageMotion(shown), PageText(left) if left else None)
    page.add("The mechanism at the start", picture, folded=True)


def _summary(run: Trajectory) -> list[tuple[str, str]]:
    stats, system = run.stats, run.system
    rows = [
        ("status", str(run.status)),
        ("time reached [s]", f"{float(run.t_reached):.9g}"),
        ("samples", f"{len(run.ts):,}"),
        ("method", run.choice),
        ("steps tried", f"{int(stats.n_steps):,}"),
        ("steps kept", f"{int(stats.n_accepted):,}"),
        ("steps repeated", f"{int(stats.n_rejected):,}"),
        ("evaluations of the equations of motion", f"{int(stats.n_evaluations):,}"),
    ]
    if run.settings is not None:
        atol = "by kind of component" if run.settings.atol is None else f"{run.settings.atol:g}"
        rows += [("relative tolerance", f"{run.settings.rtol:g}"), ("absolute tolerance", atol)]
        rows.append(("largest number of steps", f"{run.settings.max_steps:,}"))
    rows += [
        (f"contact onsets of {name}", f"{int(n):,}")
        for name, n in zip(system.contact_joints, np.asarray(stats.n_onsets), strict=True)
    ]
    if stats.explanation:
        rows.append(("why so", stats.explanation))
    energy = np.asarray(run.mechanical_energy)
    there = np.isfinite(energy)
    if there.any():
        rows.append(("mechanical energy at the start [J]", f"{energy[there][0]:.9g}"))
        rows.append(("change of it until the last sample [J]", f"{energy[there][-1] - energy[there][0]:.6g}"))
    if system.tracks_supply and np.isfinite(np.asarray(run.supplied_work)).any():
        rows.append(("work put in by drivers and forces [J]", f"{_last(run.supplied_work):.6g}"))
    rows.append(("largest constraint violation [m or 1]", _largest(run.constraint_violation)))
    rows.append(("largest violation of the velocities [m/s or 1/s]", _largest(run.velocity_violation)))
    return [*rows, ("constraint equations", str(run.constraints))]


def _last(values) -> float:
    values = np.asarray(values)
    return float(values[np.isfinite(values)][-1])


def _largest(values) -> str:
    values = np.asarray(values)
    values = values[np.isfinite(values)]
    return f"{values.max():.3g}" if values.size else "not known"


def _audit(run: Trajectory) -> PageTable:
    rows, texts = [], texts_for(run.system)
    for check, share in zip(CHECKS, np.asarray(run.stats.audit), strict=True):
        made, is_bad = share != NOT_MADE, share > 1
        said = ("beyond its range" if check in WARNINGS else "FAILED") if is_bad else "held" if made else "not made"
        rows.append((WHAT_IS_AUDITED[check], f"{share:.2e}" if made else "-", texts[check] if is_bad else said))
    return PageTable(("what was looked at, at every step", "worst, as a share of the limit", "found"), rows, "Audit")


def add_run(page: Page, run: Trajectory) -> None:
    """Figures, peaks and contacts of a single run."""
    figures = [PagePicture(figure, what) for what, figure in figures_of_run(run).items()]
    page.add("Histories", *figures)
    page.add("Energy by part", *_energy_by_part(run))
    page.add("Peaks", _peaks(run))
    if run.system.forces:
        page.add("Force elements", _force_elements(run))
    for joint in run.system.contact_joints:
        page.add(f"Contacts of {joint}", *_contacts(run, joint))


def _peaks(run: Trajectory) -> PageTable | PageText:
    """Largest magnitudes over all steps, not over the samples."""
    system = run.system
    names = [f"{kind}.{body}" for body in system.bodies for kind in ("velocity", "acceleration")]
    names += [f"{kind}.{joint}" for joint in system.joints for kind in ("reaction", "reaction_moment")]
    try:
        found = peaks(system, run._steps, tuple(names), run.scalar)  # as `run.peak`, of all at once
    except SceneError as error:
        return PageText([str(error)])
    rows = [
        (name, f"{one.value:.6g}", quantity(name, system).unit, f"{one.time:.6g}")
        for name, one in zip(names, found, strict=True)
    ]
    caption = "Largest magnitudes, seen at five instants of each step"
    return PageTable(("quantity", "largest", "unit", "at [s]"), rows, caption)


def _energy_by_part(run: Trajectory) -> list[PagePicture | PageTable | PageText]:
    """What was put in, what is stored, and what was lost where: a figure, and a table at the end of the run."""
    try:
        balance = run.energy_by_part
    except SceneError as error:
        return [PageText([str(error)])]
    kinds = balance.put_in, balance.stored, balance.lost
    ends = [{name: float(values[-1]) for name, values in kind.items()} for kind in kinds]
    largest = max(abs(value) for kind in ends for value in kind.values())
    unit, factor = energy_unit(largest)
    names = list(dict.fromkeys(name for kind in ends for name in kind))

    def in_unit(value: float | None) -> str:
        return "" if value is None else f"{factor * value:.5g}"

    rows = [(name, *(in_unit(kind.get(name)) for kind in ends)) for name in names]
    rows.append(("all together", *(in_unit(sum(kind.values())) for kind in ends)))
    left = float(balance.unaccounted[-1])
    caption = (
        f"Energy from the start to t = {float(balance.ts[-1]):.6g} s. Put in, less stored, less lost: "
        f"{factor * left:.2g} {unit} unaccounted for, by the errors of the integration"
    )
    heads = ("part", *(f"{kind} [{unit}]" for kind in ("put in", "stored", "lost")))
    return [
        PagePicture(draw_energy_by_part(balance), "energy that was put in, is stored and was lost, by part"),
        PageTable(heads, rows, caption),
    ]


def _force_elements(run: Trajectory) -> PageTable:
    """What each force element did: ranges of its named results, and the work that it put into the bodies."""
    rows = []
    ts = np.asarray(run.ts)
    for name, element in run.system.forces.items():
        for key, values in run.force(name).items():
            values = np.asarray(values)
            sizes = np.linalg.norm(values.reshape(len(ts), -1), axis=1) if values.ndim > 1 else values
            there = np.isfinite(sizes)
            if not there.any():
                continue
            what = f"{key}, magnitude" if values.ndim > 1 else key
            least, most = float(sizes[there].min()), float(sizes[there].max())
            unit = element.part_units.get(key, "")
            rows.append((name, what.replace("_", " "), unit, f"{least:.6g}", f"{most:.6g}", f"{sizes[there][-1]:.6g}"))
            if key == "power":
                work = np.concatenate([np.zeros(1), np.cumsum(0.5 * (sizes[1:] + sizes[:-1]) * np.diff(ts))])
                told = f"{work[there].min():.6g}", f"{work[there].max():.6g}", f"{work[there][-1]:.6g}"
                rows.append((name, "work put into the bodies, by the samples", "J", *told))
    heads = ("element", "result", "unit", "smallest", "largest", "at the end")
    return PageTable(heads, rows, "Results of force elements at the samples")


def _contacts(run: Trajectory, joint: str) -> list[PageTable | PageText]:
    try:
        found = run.impacts(joint)
    except SceneError as error:
        return [PageText([str(error)])]
    if not found.sizes["contact"]:
        return [PageText(["The ball never touches its socket."])]
    columns = [str(name) for name in found.data_vars if found[name].dims == ("contact",)]
    heads = ("contact", *(f"{name.replace('_', ' ')} [{found[name].attrs.get('units', '')}]" for name in columns))
    values = np.stack([np.asarray(found[name], float) for name in columns], -1)
    rows = [(str(i + 1), *("-" if np.isnan(x) else f"{x:.5g}" for x in row)) for i, row in enumerate(values)]
    return [PageTable(heads, rows, f"{len(rows):,} contacts, in the order of their onsets", numeric=True)]


def add_sources(page: Page, described: Scene | Trajectory, run: Trajectory | None = None) -> None:
    """What everything rests on: the numbers, what to cite, versions.

    Args:
        page: to which it is added.
        described: the scene whose numbers are listed, or a run of it.
        run: the run, whose method is cited too.
    """
    add_numbers(page, described.system if isinstance(described, Trajectory) else described)
    add_cited(page, [described if run is None else run])
    add_versions(page)


def add_numbers(page: Page, described: Scene | System, title: str = "Numbers used", below: str = "") -> None:
    """Every number with its unit; `below` a name, those of one part."""
    numbers = [one for one in numbers_of(described) if one.name.startswith(below)]
    joints = "world axes at the start" if isinstance(described, Scene) else "body axes"
    caption = f"{len(numbers):,} entries, SI units; points and axes of joints in {joints}"
    page.add(title, PageTable(("name", "value", "unit", "what it is"), numbers, caption), folded=bool(below))


def add_cited(page: Page, sources: Sequence[Scene | Trajectory]) -> None:
    """What to cite: each work once, and what for."""
    found: dict[str, dict[str, None]] = {}
    for source in sources:
        work = ""
        for line in cite(source).splitlines():
            if line.startswith("    for "):
                found[work] |= dict.fromkeys(line.removeprefix("    for ").split(", "))
            else:
                work = line
                found.setdefault(work, {})
    rows = [(work, ", ".join(uses)) for work, uses in found.items()]
    page.add("What to cite", PageTable(("work", "for"), rows))


def add_versions(page: Page) -> None:
    """Versions, machine, and when the report was made."""
    rows = [(name, version(name)) for name in PACKAGES]
    rows += [
        ("Python", platform.python_version()),
        ("system", f"{platform.system()} {platform.machine()}, {sys.byteorder}-endian"),
        ("JAX runs on", f"{jax.default_backend()}, {jax.devices()[0].device_kind}"),
        ("report made", datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")),
    ]
    page.add("Versions", PageTable(("what", "which"), rows))


# Many runs ------------------------------------------------------------------------------------------------------------


def _page_of_lanes(runs: Trajectory, title: str, scene: Scene | None) -> Page:
    """All lanes in a table; the first that failed, or the first, in full."""
    ended = np.asarray(runs.ended)
    flat = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(ended.size, *np.shape(leaf)[ended.ndim :]), runs)
    ended = ended.ravel()
    bad = np.flatnonzero(ended != Status.SUCCEEDED)
    chosen = int(bad[0]) if bad.size else 0
    verdict = f"FAILED: {bad.size:,} of {ended.size:,} runs." if bad.size else f"Succeeded: all {ended.size:,} runs."
    page = Page(title or f"{ended.size:,} motions of {', '.join(runs.system.bodies)}", verdict)
    page.failed += flat.diagnosis.splitlines()[:10]
    if bad.size > 10:
        page.failed.append(f"... and {bad.size - 10:,} more; see the table.")
    if said := cautions(np.asarray(flat.stats.audit)):
        page.cautions.append(said)
    rows = [
        (
            str(lane),
            Status(int(ended[lane])).name.lower().replace("_", " "),
            f"{float(flat.t_reached[lane]):.6g}",
            f"{int(flat.stats.n_steps[lane]):,}",
            f"{int(flat.stats.n_rejected[lane]):,}",
            f"{int(np.sum(flat.stats.n_onsets[lane])):,}",
        )
        for lane in range(ended.size)
    ]
    heads = ("lane", "status", "time reached [s]", "steps", "repeated", "contact onsets")
    page.add("All lanes", PageTable(heads, rows, numeric=True))
    one = jax.tree.map(lambda leaf: leaf[chosen], flat)
    page.cautions += [f"lane {chosen}: {said}" for said in start_changes(one.system, one.ts, one.assembly)]
    why = "the first that failed" if bad.size else "the first"
    page.add(f"Lane {chosen}", PageText([f"What follows is lane {chosen}, {why}. {_verdict(one)}"]))
    add_motion(page, {f"lane {chosen}": one}, scene)
    page.add("The run", pairs(_summary(one)), _audit(one))
    with _heard(page):
        add_run(page, one)
    add_sources(page, one, one)
    return page
