"""The spatial four-bar: five models (Figs 18 to 21), parameter studies (Figs 10 to 17), limits to the ideal joint."""

from collections.abc import Callable

from spherejax.gallery import four_bar
from spherejax.physics.joints.lubricated import Lubricated
from spherejax.physics.laws.friction import Ambrosio, BengisuAkay, BrownMcPhee, Coulomb, Threlfall
from spherejax.physics.laws.normal import (
    ExactRestitution,
    Flores,
    Gonthier,
    Hertz,
    HuntCrossley,
    LankaraniNikravesh,
)
from spherejax.studies.cases import CLEARANCE, VISCOSITY, five_models, limit_studies, parameter_studies
from spherejax.studies.subject import Comparison, Length, StudyResult, Subject, TableColumn

PARAMETERS = "c = 0.10 mm, Lankarani-Nikravesh 0.9, Threlfall mu 0.1, 0.4 Pa s, k = 1e6 N/m, b = 1e-2 s"
"""Parameters of the five models, for titles."""

AFTER_IMPACTS, HALF_WINDOW = 0.3, 0.02
"""The close-up of Fig. 14 looks from here on [s], and shows this much on either side [s]."""

COLUMNS = (
    TableColumn("energy lost [mJ]", lambda row: 1e3 * row.lost_energy),
    TableColumn("peak acceleration [m/s^2]", lambda row: row.peak_acceleration),
    TableColumn("max |e| / 0.10 mm", lambda row: row.eccentricity_ratio),
    TableColumn("onsets", lambda row: row.n_onsets, "d"),
    TableColumn("steps", lambda row: row.n_steps, ",d"),
    TableColumn("warm run [s]", lambda row: row.seconds, ".3g"),
    TableColumn("time ratio", lambda row: row.time_ratio, ".3g"),
    TableColumn("repeatable until [s]", lambda row: row.horizon, lambda t: "the end" if t is None else f"{t:.3g}"),
)


def figures(comparison: "Comparison") -> dict[str, Callable]:
    """Functions that draw the figures, by file name; of a comparison that is not done yet, those that can be drawn."""
    from spherejax.output.plot import histories, limits, phase, ratios
    from spherejax.output.plot.eccentricity import eccentricity_paths
    from spherejax.output.plot.style import MODEL_COLORS

    models, ideal, parameters = comparison.models, comparison.models["ideal"], comparison.subject.parameters
    found = figures_ahead(comparison.subject)
    for result in comparison.studies:
        if result.study.chaotic and "dry" not in comparison.horizons:
            continue
        found[_file_name(result)] = lambda result=result: study_figure(result, comparison)
    others = [one for name, one in models.items() if name != "ideal"]
    colors = [MODEL_COLORS[name] for name in models if name != "ideal"]
    found["fig18_models"] = lambda: histories.four_histories(
        others, ideal, f"Joint models: {parameters}", colors=colors
    )
    found["fig19_phase_portraits"] = lambda: phase.phase_portraits(
        models, f"Phase portraits; grey: ideal\n{parameters}"
    )
    found["fig20_eccentricity"] = lambda: eccentricity_paths(
        models, f"Ball's center in the socket; orange: in contact\n{parameters}"
    )
    if comparison.rows:
        found["fig21_time_ratio"] = lambda: ratios.time_ratios(
            {row.name: row.label for row in comparison.rows},
            [row.time_ratio for row in comparison.rows],
            [row.n_steps for row in comparison.rows],
            f"Computing time of {comparison.t_end:g} s of motion (one core, warm, rtol 1e-8)",
        )
    if comparison.limits:
        found["limits"] = lambda: limits.limits_to_ideal(
            [
                limits.LimitCurve(r.label, r.parameter, r.values, r.deviations, r.order, r.kind)
                for r in comparison.limits
            ],
            f"Limits to the ideal joint, {comparison.t_limits:g} s of motion",
        )
    return found


def figures_ahead(subject: Subject) -> dict[str, Callable]:
    """Those of the figures that need no run."""
    del subject
    return {**law_figures(), "fig09_mechanism": _mechanism}


def _mechanism():
    """The mechanism, and the height that the other figures show."""
    from spherejax.output.plot.heights import with_height

    return with_height(four_bar(), "rocker", "Four-bar, at the start; z: height of the rocker's center of mass")


def law_figures() -> dict[str, Callable]:
    """Figures 6 to 8, which need no simulation."""
    from spherejax.output.plot import laws

    joint = Lubricated(CLEARANCE, viscosity=VISCOSITY)
    normal = (HuntCrossley, LankaraniNikravesh, Gonthier, Flores, ExactRestitution)
    families = {c_r: [Hertz(), *(law(restitution=c_r) for law in normal)] for c_r in (0.9, 0.3)}
    rubbing = [Coulomb(), Threlfall(), BengisuAkay(), Ambrosio(), BrownMcPhee()]
    return {
        "fig06_normal_laws": lambda: laws.impact_loops(families, stiffness=1.508882e11),
        "fig07_friction_laws": lambda: laws.friction_curves(
            rubbing, "Friction laws in steady sliding, parameters of Table 3"
        ),
        "fig08_hybrid_film": lambda: laws.hybrid_force(joint),
    }


def study_figure(result: "StudyResult", comparison: "Comparison"):
    """Figures 10 to 17."""
    from spherejax.output.plot import histories
    from spherejax.output.plot.style import FILM_COLORS, LAW_COLORS, ordered_colors

    study, ideal = result.study, comparison.models["ideal"]
    colors = ordered_colors(len(study.cases)) if study.ordered else FILM_COLORS if study.of_films else LAW_COLORS
    horizon = comparison.horizons["dry"] if study.chaotic else None
    if study.histories:
        return histories.four_histories(result.curves, ideal, study.title, colors=colors, horizon=horizon)
    window = None
    if study.close_up:
        window = histories.slowest_sliding(result.curves[0], after=AFTER_IMPACTS, half_width=HALF_WINDOW)
    return histories.acceleration_and_energy(
        result.curves, ideal, study.title, colors=colors, horizon=horizon, close_up=window
    )


def _file_name(result: "StudyResult") -> str:
    subjects = {
        "fig10": "dry_clearance", "fig11": "dry_normal_law", "fig12": "friction_clearance",
        "fig13": "friction_normal_law", "fig14": "friction_law", "fig15": "lubricated_clearance",
        "fig15b": "lubricated_films", "fig16": "bushing_stiffness", "fig17": "bushing_damping",
    }  # fmt: skip
    return f"{result.study.name}_{subjects[result.study.name]}"


FOUR_BAR = Subject(
    name="four-bar",
    build=four_bar,
    body="rocker",
    joint="coupler_rocker",
    models=five_models,
    parameters=PARAMETERS,
    full=Length(seconds=2.0, interval=1e-5),  # the paper's; an impact lasts for about 5e-5 s, so its peak is seen
    quick=Length(seconds=0.2, interval=1e-5, n_studies=1, limits=False),
    columns=COLUMNS,
    figures=figures,
    figures_ahead=figures_ahead,
    studies=parameter_studies,
    limits=limit_studies,
    t_limits=0.5,  # dry motion is hardly chaotic until then
    reference=CLEARANCE,
    apart=1e-5,  # a tenth of the clearance
)
"""The paper's first mechanism."""
