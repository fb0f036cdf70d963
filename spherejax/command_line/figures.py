"""The figures of a comparison: which there are, and what they are called."""

from collections.abc import Callable

import spherejax as sj
from spherejax.output.plot import histories, laws, limits, phase, ratios
from spherejax.output.plot.eccentricity import eccentricity_paths
from spherejax.output.plot.style import LAW_COLORS, MODEL_COLORS, ordered_colors
from spherejax.studies.cases import CLEARANCE
from spherejax.studies.compare import Comparison, StudyResult

FIVE = "c = 0.10 mm, Lankarani-Nikravesh 0.9, Threlfall mu 0.1, 0.4 Pa s, k = 1e6 N/m, b = 1e-2 s"
"""Parameters of the five models, for titles."""

AFTER_IMPACTS, HALF_WINDOW = 0.3, 0.02
"""The close-up of Fig. 14 looks from here on [s], and shows this much on either side [s]."""


def figures_of(comparison: Comparison) -> dict[str, Callable]:
    """Functions that draw the figures, by file name."""
    models, ideal = comparison.models, comparison.models["ideal"]
    found: dict[str, Callable] = {**law_figures()}
    for result in comparison.studies:
        found[_file_name(result)] = lambda result=result: study_figure(result, comparison)
    others = [one for name, one in models.items() if name != "ideal"]
    colors = [MODEL_COLORS[name] for name in models if name != "ideal"]
    found["fig18_models"] = lambda: histories.four_histories(others, ideal, f"Joint models: {FIVE}", colors=colors)
    found["fig19_phase_portraits"] = lambda: phase.phase_portraits(models, f"Phase portraits; grey: ideal\n{FIVE}")
    found["fig20_eccentricity"] = lambda: eccentricity_paths(
        models, f"Ball's center in the socket; orange: in contact\n{FIVE}"
    )
    found["fig21_time_ratio"] = lambda: ratios.time_ratios(
        [row.name for row in comparison.rows],
        [row.time_ratio for row in comparison.rows],
        [row.n_steps for row in comparison.rows],
        f"Computing time of {comparison.t_end:g} s of motion (one core, warm, rtol 1e-8)",
    )
    if comparison.limits:
        found["limits"] = lambda: limits.limits_to_ideal(
            [limits.Limit(r.label, r.parameter, r.values, r.deviations, r.order) for r in comparison.limits],
            f"Limits to the ideal joint, {comparison.t_limits:g} s of motion",
        )
    return found


def law_figures() -> dict[str, Callable]:
    """Figures 6 to 8, which need no simulation."""
    joint = sj.Lubricated(CLEARANCE, viscosity=0.4)
    normal = (sj.HuntCrossley, sj.LankaraniNikravesh, sj.Gonthier, sj.Flores, sj.ExactRestitution)
    families = {c_r: [sj.Hertz(), *(law(restitution=c_r) for law in normal)] for c_r in (0.9, 0.3)}
    rubbing = [sj.Coulomb(), sj.Threlfall(), sj.BengisuAkay(), sj.Ambrosio(), sj.BrownMcPhee()]
    return {
        "fig06_normal_laws": lambda: laws.impact_loops(families, stiffness=1.508882e11),
        "fig07_friction_laws": lambda: laws.friction_curves(rubbing),
        "fig08_hybrid_film": lambda: laws.hybrid_force(joint),
    }


def study_figure(result: StudyResult, comparison: Comparison):
    """Figures 10 to 17."""
    study, ideal = result.study, comparison.models["ideal"]
    colors = ordered_colors(len(study.cases)) if study.ordered else LAW_COLORS
    horizon = comparison.horizons["dry"] if study.chaotic else None
    if study.histories:
        return histories.four_histories(result.curves, ideal, study.title, colors=colors, horizon=horizon)
    window = None
    if study.close_up:
        window = histories.slowest_sliding(result.curves[0], after=AFTER_IMPACTS, half_width=HALF_WINDOW)
    return histories.acceleration_and_energy(
        result.curves, ideal, study.title, colors=colors, horizon=horizon, close_up=window
    )


def _file_name(result: StudyResult) -> str:
    subjects = {
        "fig10": "dry_clearance", "fig11": "dry_normal_law", "fig12": "friction_clearance",
        "fig13": "friction_normal_law", "fig14": "friction_law", "fig15": "lubricated_clearance",
        "fig16": "bushing_stiffness", "fig17": "bushing_damping",
    }  # fmt: skip
    return f"{result.study.name}_{subjects[result.study.name]}"
