"""The cases of the comparison: five joint models, the parameter studies of Figs 10 to 17, and the limits.

Parameters as printed in the paper (Tables 3 and 4) where they are legible. Chosen here: restitution 0.9, the
largest clearance 0.20 mm, the clearance 0.10 mm of the law studies, and the bushings (k = 1e6 N/m with b =
1e-2 s; k = 1e5 and 1e7 N/m; b = 1e-4 and 1e-3 s). The film is the full one unless the paper's, the radial one, is asked
for; one figure shows both.
"""

from collections.abc import Callable
from dataclasses import dataclass

from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.dry import Dry
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.lubricated import Lubricated
from spherejax.physics.laws.films import AbstractFilm, FullFilm, RadialFilm
from spherejax.physics.laws.friction import (
    AbstractFrictionLaw,
    Ambrosio,
    BengisuAkay,
    BrownMcPhee,
    Threlfall,
)
from spherejax.physics.laws.normal import (
    AbstractNormalLaw,
    Flores,
    Gonthier,
    HuntCrossley,
    LankaraniNikravesh,
)

CLEARANCE = 1e-4
"""Clearance of the five models and of the law studies [m]."""

CLEARANCES = (5e-5, 1e-4, 2e-4)
"""Clearances of Figs 10, 12 and 15 [m]."""

RESTITUTION = 0.9
"""Restitution of all normal laws [-]."""

VISCOSITY = 0.4
"""Dynamic viscosity of the lubricant [Pa s]: 400 cP."""

STIFFNESS, DAMPING = 1e6, 1e-2
"""The bushing's stiffness [N/m] and stiffness-proportional damping [s]."""


@dataclass(frozen=True)
class Case:
    """One simulation.

    Attributes:
        label: what the legend says.
        kind: short name of the joint model.
        parameters: name and value of what `build` is given.
        build: makes the joint's model from the parameters.
    """

    label: str
    kind: str
    parameters: tuple[tuple[str, object], ...]
    build: Callable[..., AbstractSphericalModel]

    def model(self) -> AbstractSphericalModel:
        """The model of the studied joint."""
        return self.build(**dict(self.parameters))

    def __eq__(self, other) -> bool:
        return isinstance(other, Case) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self):
        # Labels differ from figure to figure; the simulation is the same.
        return self.kind, tuple((name, repr(value)) for name, value in self.parameters)


@dataclass(frozen=True)
class Study:
    """Cases that differ in one thing.

    Attributes:
        name: file name of its figure, e.g. `"fig10"`.
        title: what is varied and what stays.
        cases: what is compared.
        histories: whether position and velocity are shown as well (Figs 10, 12, 15, 16).
        chaotic: whether late histories depend on the tolerance.
        ordered: whether the cases are values of one number.
        close_up: whether the figure shows the instants near zero sliding.
        of_films: whether the cases are the paper's film and the full one, which have colors of their own.
    """

    name: str
    title: str
    cases: tuple[Case, ...]
    histories: bool = False
    chaotic: bool = False
    ordered: bool = False
    close_up: bool = False
    of_films: bool = False


@dataclass(frozen=True)
class LimitStudy:
    """Values of one parameter that make a model tend to the ideal joint.

    Attributes:
        label: the joint model, with the parameters that stay.
        parameter: name and unit.
        values: from far to near.
        model_of: the joint's model for a value.
        order: expected power of the parameter.
        kind: short name of the joint model.
    """

    label: str
    parameter: str
    values: tuple[float, ...]
    model_of: Callable[[float], AbstractSphericalModel]
    order: int | None
    kind: str


def dry_case(label: str, clearance: float = CLEARANCE, normal: AbstractNormalLaw | None = None) -> Case:
    """Dry contact without friction."""
    law = LankaraniNikravesh(restitution=RESTITUTION) if normal is None else normal
    return Case(label, "dry", (("clearance", clearance), ("normal", law)), Dry)


def friction_case(
    label: str,
    clearance: float = CLEARANCE,
    normal: AbstractNormalLaw | None = None,
    friction: AbstractFrictionLaw | None = None,
) -> Case:
    """Dry contact with friction, Threlfall's unless another law is given."""
    law = LankaraniNikravesh(restitution=RESTITUTION) if normal is None else normal
    rubbing = Threlfall() if friction is None else friction
    return Case(label, "friction", (("clearance", clearance), ("normal", law), ("friction", rubbing)), Dry)


def lubricated_case(
    label: str, clearance: float = CLEARANCE, film: AbstractFilm | None = None, viscosity: float = VISCOSITY
) -> Case:
    """Lubricated joint, with the full film unless another is given; with the paper's film the paper's contact."""
    # Table 3 has the same transition at every clearance.
    transition = (("e_h0", 1e-6), ("e_h1", 2e-6))
    parameters = (("clearance", clearance), ("viscosity", viscosity), ("film", film or FullFilm()), *transition)
    if isinstance(film, RadialFilm):
        parameters = (*parameters, ("normal", LankaraniNikravesh(restitution=RESTITUTION)))
    return Case(label, "lubricated", parameters, Lubricated)


def film_name(film: AbstractFilm | None) -> str:
    """For titles."""
    return "radial film, the paper's" if isinstance(film, RadialFilm) else "full film"


def bushing_case(label: str, stiffness: float = STIFFNESS, damping: float = DAMPING) -> Case:
    """Bushing."""
    return Case(label, "bushing", (("stiffness", stiffness), ("damping", damping)), Bushing)


def five_models(
    stiffness: float = STIFFNESS, damping: float = DAMPING, film: AbstractFilm | None = None
) -> dict[str, Case]:
    """The five models of Figs 18 to 25 by short name, with this bushing [N/m, s] and film."""
    return {
        "ideal": Case("ideal", "ideal", (), Ideal),
        "dry": dry_case("dry"),
        "friction": friction_case("dry with friction"),
        "lubricated": lubricated_case("lubricated", film=film),
        "bushing": bushing_case("bushing", stiffness, damping),
    }


def _normal_laws() -> dict[str, AbstractNormalLaw]:
    laws = {
        "Hunt-Crossley": HuntCrossley,
        "Lankarani-Nikravesh": LankaraniNikravesh,
        "Gonthier": Gonthier,
        "Flores": Flores,
    }
    return {name: law(restitution=RESTITUTION) for name, law in laws.items()}


def _friction_laws() -> dict[str, AbstractFrictionLaw]:
    return {
        "Threlfall": Threlfall(),
        "Bengisu-Akay": BengisuAkay(),
        "Ambrosio": Ambrosio(),
        "Brown-McPhee": BrownMcPhee(),
    }


def _gap(clearance: float) -> str:
    return f"c = {1e3 * clearance:.2f} mm"


def parameter_studies(film: AbstractFilm | None = None) -> list[Study]:
    """Figs 10 to 17; with this film those of the lubricated joint, which one more shows with both films."""
    friction = "Threlfall friction (mu = 0.1, v1 = 1 mm/s)"
    law = "Lankarani-Nikravesh, restitution 0.9"
    return [
        Study("fig10", f"Dry joint without friction: clearance ({law})",
              tuple(dry_case(_gap(c), c) for c in CLEARANCES), histories=True, chaotic=True, ordered=True),
        Study("fig11", "Dry joint without friction: normal law (c = 0.10 mm, restitution 0.9)",
              tuple(dry_case(name, normal=one) for name, one in _normal_laws().items()), chaotic=True),
        Study("fig12", f"Dry joint with friction: clearance\n({law}; {friction})",
              tuple(friction_case(_gap(c), c) for c in CLEARANCES), histories=True, ordered=True),
        Study("fig13", f"Dry joint with friction: normal law\n(c = 0.10 mm, restitution 0.9; {friction})",
              tuple(friction_case(name, normal=one) for name, one in _normal_laws().items())),
        Study("fig14", f"Dry joint with friction: friction law (c = 0.10 mm; {law})",
              tuple(friction_case(name, friction=one) for name, one in _friction_laws().items()),
              close_up=True),
        Study("fig15", f"Lubricated joint: clearance ({film_name(film)}; 0.4 Pa s, Guembel's condition)",
              tuple(lubricated_case(_gap(c), c, film) for c in CLEARANCES), histories=True, ordered=True),
        Study("fig15b", "Lubricated joint: the paper's film against the full one (c = 0.10 mm; 0.4 Pa s, Guembel)",
              tuple(lubricated_case(film_name(each), film=each) for each in (RadialFilm(), FullFilm())),
              histories=True, of_films=True),
        Study("fig16", "Bushing: stiffness k (b = 1e-2 s)",
              tuple(bushing_case(f"k = {k:.0e} N/m", stiffness=k) for k in (1e5, 1e6, 1e7)),
              histories=True, ordered=True),
        Study("fig17", "Bushing: damping b (k = 1e6 N/m)",
              tuple(bushing_case(f"b = {b:.0e} s", damping=b) for b in (1e-4, 1e-3, 1e-2)), ordered=True),
    ]  # fmt: skip


def limit_studies(film: AbstractFilm | None = None) -> list[LimitStudy]:
    """The limits in which each model becomes the ideal joint, the lubricated one with this film.

    Friction does not vanish with the clearance: the ball is as large as before, and so is the friction moment. The
    full film resists relative spin by 8 pi nu R**4/(3 c), which grows as it carries better: neither limit of the
    lubricated joint is the ideal one, but for the paper's film, which has no moment.
    """
    gap, clearances = "clearance [mm]", (0.4, 0.2, 0.1, 0.05, 0.025)
    threlfall = Threlfall()
    few, ends = clearances, ""
    if isinstance(film, RadialFilm):
        few, ends = clearances[:3], "\nits curve ends where it rings so fast that runs take long"
    return [
        LimitStudy("dry with friction: its moment stays", gap, clearances,
                   lambda c: Dry(1e-3 * c, friction=threlfall), None, "friction"),
        LimitStudy("dry without friction", gap, clearances, lambda c: Dry(1e-3 * c), 1, "dry"),
        LimitStudy(f"lubricated ({film_name(film)}), 0.4 Pa s{ends}", gap, few,
                   lambda c: lubricated_case("", 1e-3 * c, film).model(), None, "lubricated"),
        LimitStudy("bushing, b = 1e-4 s", "bushing stiffness [N/m]", (1e4, 1e5, 1e6, 1e7),
                   lambda k: Bushing(k, 1e-4), -1, "bushing"),
        *(LimitStudy(f"lubricated ({film_name(each)}), c = 0.10 mm", "viscosity [Pa s]", (0.1, 0.4, 1.6, 6.4),
                     lambda nu, each=each: lubricated_case("", film=each, viscosity=nu).model(), order, "lubricated")
          for each, order in ((FullFilm(), None), (RadialFilm(), -1)) if order or not isinstance(film, RadialFilm)),
    ]  # fmt: skip
