"""The spatial four-bar: five models (Figs 18 to 21), parameter studies (Figs 10 to 17), limits to the ideal joint."""

from collections.abc import Callable
from functools import partial

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
from spherejax.studies.subject import Length, Subject
from spherejax.studies.subjects.own import figures

NUMBERS = {
    "normal_laws": "fig06", "friction_laws": "fig07", "hybrid_film": "fig08", "mechanism": "fig09",
    "dry_clearance": "fig10", "dry_normal_law": "fig11", "friction_clearance": "fig12",
    "friction_normal_law": "fig13", "friction_law": "fig14", "lubricated_clearance": "fig15",
    "lubricated_films": "fig15b", "bushing_stiffness": "fig16", "bushing_damping": "fig17",
    "models": "fig18", "phase_portraits": "fig19", "eccentricity": "fig20", "time_ratio": "fig21",
}  # fmt: skip
"""Of the paper's figures."""


def figures_ahead(subject: Subject) -> dict[str, Callable]:
    """Those of the figures that need no run."""
    del subject
    return {**law_figures(), "mechanism": _mechanism}


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
        "normal_laws": lambda: laws.impact_loops(families, stiffness=1.508882e11),
        "friction_laws": lambda: laws.friction_curves(
            rubbing, "Friction laws in steady sliding, parameters of Table 3"
        ),
        "hybrid_film": lambda: laws.hybrid_force(joint),
    }


FOUR_BAR = Subject(
    name="four-bar",
    build=four_bar,
    joint="coupler_rocker",
    models=five_models(),
    full=Length(seconds=2.0, interval=1e-5),  # the paper's; an impact lasts for about 5e-5 s, so its peak is seen
    quick=Length(seconds=0.2, interval=1e-5, n_studies=1, limits=False),
    body="rocker",
    axis="z",
    figures=partial(figures, plane=(0, 2)),  # the plane in which the rocker swings
    figures_ahead=figures_ahead,
    numbers=NUMBERS,
    studies=parameter_studies,
    limits=limit_studies,
    t_limits=0.5,  # dry motion is hardly chaotic until then
    reference=CLEARANCE,
)
"""The paper's first mechanism."""
