"""Any mechanism whose joint models are compared: a scene or a builder, and one of its joints.

What is said and drawn of any mechanism stands here. The paper's two have more: see `four_bar` and `suspension`.
"""

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import equinox as eqx
import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.results.trajectory import Trajectory
from spherejax.output.plot.curves import Curves, check_axis
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.spherical import Spherical
from spherejax.studies.cases import Case, cases_of, joint_models, limit_studies, parameter_studies
from spherejax.studies.subject import RTOL, Comparison, Length, SceneOf, StudyResult, Subject

INTERVAL = 1e-5
"""Of the samples [s]: an impact of steel lasts for about 5e-5 s, so its peak is seen."""

MOST_SAMPLES, FEWEST_SAMPLES = 200_001, 2001
"""Of a run; all that is observed at so many samples takes some 0.3 GB."""

T_LIMITS = 0.25
"""How much of the motion the limits to the ideal joint make: dry motion is hardly chaotic until then."""

BALL_PATH, JOURNAL_PATH = "Ball's center in the socket", "Journal's center in its bearing"
"""What the figure of eccentricities shows."""

AFTER_IMPACTS, HALF_WINDOW = 0.15, 0.01
"""The close-up of a study of friction laws looks from here on, and shows this much on either side; shares of the
motion."""


# The mechanism -------------------------------------------------------------------------------------------------------


def own_mechanism(
    scene: Scene | Callable[..., Scene],
    t1: float,
    *,
    joint: str | None = None,
    models: Mapping[str, AbstractSphericalModel] | None = None,
    body: str | None = None,
    axis: str | None = None,
    samples: int | None = None,
    rtol: float = RTOL,
    name: str = "",
) -> Subject:
    """What `compare` is asked for, checked before anything is computed.

    Args:
        scene: the mechanism, or a builder.
        t1: length of the motion [s].

    Other args:
        joint, models, body, axis, samples, rtol, name: as in `sj.compare`.

    Raises:
        SceneError: for what cannot be compared.
    """
    if not (np.ndim(t1) == 0 and np.isfinite(t1) and t1 > 0):
        raise SceneError(f"t1 = {t1!r} must be a positive time [s]")
    if samples is not None and samples < 2:
        raise SceneError(f"samples = {samples!r} must be at least 2: start and end")
    check_axis(axis)
    build, joint, described = _built(scene, joint)
    studied: Any = described.joints[joint]
    cases = cases_of(joint_models(studied.model) if models is None else models)
    _check_length(studied, joint, cases)
    for case in cases.values():
        compile_scene(build(case.model))  # a model that the joint cannot take is refused here, by name
    if body is not None and body not in described.bodies:
        raise SceneError(f"body = {body!r}: there is no such body; {one_of(described.bodies, body)}")
    gaps: list[Any] = [getattr(case.model, "clearance", None) for case in cases.values()]
    clearances = [float(gap) for gap in gaps if gap is not None]
    interval = t1 / (samples - 1) if samples else max(min(INTERVAL, t1 / (FEWEST_SAMPLES - 1)), t1 / (MOST_SAMPLES - 1))
    reference = clearances[0] if clearances else 1e-4
    return Subject(
        name=name or "mechanism",
        build=build,
        joint=joint,
        models=cases,
        full=Length(t1, interval),
        quick=Length(t1, interval, n_studies=0, limits=False),
        body=body,
        axis=axis,
        figures=figures if isinstance(studied, Spherical) else partial(figures, path=JOURNAL_PATH),
        figures_ahead=partial(_figures_ahead, scene=described),
        measures=partial(measures, joint),
        studies=parameter_studies,
        limits=limit_studies,
        t_limits=T_LIMITS * t1,
        reference=reference,
        tracks_work=True,
        rtol=rtol,
    )


def able_joints(scene: Scene) -> list[str]:
    """Names of the joints that can take all models: spherical ones, and revolute ones, journals in their bearings."""
    return [name for name, joint in scene.joints.items() if isinstance(joint, Spherical | Revolute)]


def studied_joint(scene: Scene, joint: str | None = None) -> str:
    """The joint that is named; else the only one that can take the models, or the only one that is not ideal already.

    Raises:
        SceneError: for a joint that is not there or takes no model; naming the able ones where none is named.
    """
    able = able_joints(scene)
    if joint is not None:
        if joint not in scene.joints:
            raise SceneError(f"joint {joint!r}: there is no such joint; {one_of(scene.joints, joint)}")
        if not hasattr(scene.joints[joint], "model"):
            kind = type(scene.joints[joint]).__name__
            raise SceneError(f"joint {joint!r}: a {kind} joint has no model; {one_of(able, '')}")
        return joint
    if not able:
        raise SceneError("no joint can take the models: they are of spherical joints and of revolute ones (journals)")
    models: dict[str, Any] = {name: getattr(scene.joints[name], "model", None) for name in able}
    modelled = [name for name in able if not models[name].is_ideal]
    chosen = able if len(able) == 1 else modelled
    if len(chosen) != 1:
        names = ", ".join(map(repr, chosen or able))
        raise SceneError(
            f"joints {names} can take the models: name the one that is studied, joint={(chosen or able)[0]!r}; on the "
            f"command line --of {(chosen or able)[0]}"
        )
    return chosen[0]


def _built(scene: Scene | Callable[..., Scene], joint: str | None) -> tuple[SceneOf, str, Scene]:
    """The scene by the model of the studied joint, that joint, and the scene as it is described."""
    if isinstance(scene, Scene):
        described = scene
    elif callable(scene) and not isinstance(scene, type):
        takes = [p for p in inspect.signature(scene).parameters.values() if p.kind is not p.KEYWORD_ONLY]
        if takes:
            return _from_builder(scene, joint)
        described = scene()
    else:
        raise SceneError(f"{scene!r} is no scene and no builder; give an sj.Scene, or a function from a model to one")
    if not isinstance(described, Scene):
        raise SceneError(f"the builder returned {described!r}, which is no sj.Scene")
    studied = studied_joint(described, joint)
    return partial(_with_model, described, studied), studied, described


def _from_builder(build: Callable[..., Scene], joint: str | None) -> tuple[SceneOf, str, Scene]:
    marker = Ideal()
    described = build(marker)
    if not isinstance(described, Scene):
        raise SceneError(f"the builder returned {described!r}, which is no sj.Scene")
    with_marker = [name for name, one in described.joints.items() if getattr(one, "model", None) is marker]
    if joint is None and len(with_marker) == 1:
        return build, with_marker[0], described
    if joint in with_marker:
        return build, str(joint), described
    if joint is None and with_marker:
        names = ", ".join(map(repr, with_marker))
        raise SceneError(f"the builder gives the model to joints {names}: name the one that is studied, joint=...")
    studied = studied_joint(described, joint)
    return partial(_with_model, described, studied), studied, described


def _with_model(scene: Scene, joint: str, model: AbstractSphericalModel) -> Scene:
    return eqx.tree_at(lambda one: one.joints[joint].model, scene, model)


def _check_length(studied: Any, joint: str, cases: Mapping[str, Case]) -> None:
    """Without the length of its bearing a revolute joint would be told which classes of conformity and film to give."""
    surfaces = [case.model for case in cases.values() if case.model.has_surfaces]
    wanted = [one for model in surfaces for one in model.requirements_of(is_bearing=True)]
    if isinstance(studied, Revolute) and not all(one.satisfied for one in wanted):
        raise SceneError(
            f"joint {joint!r} is revolute, and its models need the length of its bearing: "
            "models=sj.joint_models(length=0.02), on the command line --length 0.02"
        )


# What is measured and drawn ------------------------------------------------------------------------------------------


def measures(joint: str, run: Trajectory, one: Curves) -> Mapping[str, float]:
    """The largest force of the joint at the samples, and what it has dissipated."""
    del one
    force = np.linalg.norm(np.asarray(run.reaction(joint)), axis=1)
    there = force[np.isfinite(force)]
    numbers = {"peak joint force [N]": float(there.max(initial=0.0))}
    if joint in run.system.force_joints:
        lost = np.asarray(run.dissipated_energy(joint))
        lost = lost[np.isfinite(lost)]
        numbers["joint dissipates [J]"] = float(lost[-1]) if lost.size else float("nan")
    return numbers


def figures(
    comparison: Comparison, *, path: str = BALL_PATH, plane: tuple[int, int] | None = None
) -> dict[str, Callable]:
    """Functions that draw the figures, by file name; of a comparison that is not done yet, those that can be drawn.

    Args:
        comparison: the comparison.

    Other args:
        path: what the figure of eccentricities shows.
        plane: the world axes of that figure; those of `main_plane`, the same for all models, when None.
    """
    from spherejax.output.plot import histories, limits, phase, ratios
    from spherejax.output.plot.eccentricity import eccentricity_paths, main_plane

    subject, models, ideal = comparison.subject, comparison.models, comparison.ideal
    parameters, determined = subject.parameters, comparison.determined_until
    drawings = {subject.numbered(name): draw for name, draw in subject.figures_ahead(subject).items()}
    for result in comparison.studies:
        if result.study.of in determined:
            drawings[subject.numbered(result.study.name)] = partial(study_figure, result, comparison)
    others = [one for name, one in models.items() if name != subject.ideal]
    colors = model_colors_of(comparison)
    drawings[subject.numbered("models")] = lambda: histories.four_histories(
        others, ideal, f"Joint models: {parameters}", colors=[colors[name] for name in models if name != subject.ideal]
    )
    drawings[subject.numbered("phase_portraits")] = lambda: phase.phase_portraits(
        models, f"Phase portraits; grey: ideal\n{parameters}"
    )
    if others:
        drawings[subject.numbered("eccentricity")] = lambda: eccentricity_paths(
            models, f"{path}; orange: in contact\n{parameters}", plane=plane or main_plane(others)
        )
    if not subject.numbers and others:
        drawings["difference"] = partial(_difference, comparison)
    if comparison.rows:
        timed = [row for row in comparison.rows if np.isfinite(row.time_ratio)]
        title = f"Computing time of {comparison.t_end:g} s of motion (one core, warm, rtol {subject.rtol:g})"
        drawings[subject.numbered("time_ratio")] = lambda: ratios.time_ratios(
            {row.name: row.label for row in timed},
            [row.time_ratio for row in timed],
            [row.n_steps for row in timed],
            title.replace("1e-08", "1e-8"),
            colors=colors,
        )
    if comparison.limits:
        what = f"{ideal.body} {'angle [deg]' if ideal.turns else f'{ideal.axis} [mm]'}"
        drawings["limits"] = lambda: limits.limits_to_ideal(
            [
                limits.LimitCurve(r.label, r.parameter, r.values, r.deviations, r.order, r.kind)
                for r in comparison.limits
            ],
            f"Limits to the ideal joint, {comparison.t_limits:g} s of motion",
            what=what,
            factor=ideal.position_factor,
        )
    return drawings


def model_colors_of(comparison: Comparison) -> dict[str, Any]:
    """The color of each model, the same in all figures."""
    from spherejax.output.plot.style import model_colors

    return model_colors({name: one.kind for name, one in comparison.models.items()})


def _figures_ahead(subject: Subject, scene: Scene) -> dict[str, Callable]:
    del subject
    return {"mechanism": partial(_mechanism, scene)}


def _mechanism(scene: Scene):
    from spherejax.output.drawing import draw

    return draw(scene, title="The mechanism, at the start")


def _difference(comparison: Comparison):
    """What the models change: where the body is, against the ideal joint, and the force of the joint."""
    from spherejax.output.plot.panels import Panel, model_histories

    subject, ideal = comparison.subject, comparison.ideal
    labels = {name: one.label for name, one in comparison.models.items()}
    apart = {name: one.position - ideal.position for name, one in comparison.models.items() if name != subject.ideal}
    forces = {name: np.linalg.norm(run.reaction(subject.joint), axis=1) for name, run in comparison.runs.items()}
    what = f"{ideal.body} {f'angle about {ideal.axis[-1]}' if ideal.turns else ideal.axis}"
    unit, factor = ("mrad", 1e3) if ideal.turns else ("µm", 1e6)
    peak = max(float(np.nanpercentile(force, 99.0)) for force in forces.values())
    panels = [
        Panel("difference from the ideal joint", f"{what} [{unit}]", ideal.ts,
              {name: factor * values for name, values in apart.items()}),
        Panel(f"force of joint {subject.joint}", "force, magnitude [N]", ideal.ts, forces, limits=(0.0, 1.3 * peak)),
    ]  # fmt: skip
    return model_histories(panels, labels, f"What the models change\n{subject.parameters}", n_columns=1)


def study_figure(result: StudyResult, comparison: Comparison):
    """The figure of a parameter study: Figures 10 to 17 of the paper."""
    from spherejax.output.plot import histories
    from spherejax.output.plot.style import FILM_COLORS, LAW_COLORS, ordered_colors

    study, ideal, t_end = result.study, comparison.ideal, comparison.t_end
    colors = ordered_colors(len(study.cases)) if study.ordered else FILM_COLORS if study.of_films else LAW_COLORS
    horizon = comparison.determined_until.get(study.of)
    if study.histories:
        return histories.four_histories(result.curves, ideal, study.title, colors=colors, horizon=horizon)
    window = None
    if study.close_up:
        window = histories.slowest_sliding(
            result.curves[0], after=AFTER_IMPACTS * t_end, half_width=HALF_WINDOW * t_end
        )
    return histories.acceleration_and_energy(
        result.curves, ideal, study.title, colors=colors, horizon=horizon, close_up=window
    )
