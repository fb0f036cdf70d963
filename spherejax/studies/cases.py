"""The cases of a comparison: the five joint models, and what follows from them: parameter studies, and limits.

The numbers of the five models stand in one place, `joint_models`. Parameter studies and limits vary what the models
have: a clearance, laws, a film, a stiffness. The defaults are those of the paper (Tables 3 and 4) where they are
legible. Chosen here: restitution 0.9, the largest clearance 0.20 mm, the clearance 0.10 mm of the law studies, and the
bushings (k = 1e6 N/m with b = 1e-2 s; k = 1e5 and 1e7 N/m; b = 1e-4 and 1e-3 s). The film is the full one unless the
paper's, the radial one, is asked for; one figure shows both.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.files.fields.objects import arguments_of
from spherejax.foundations.errors import SceneError
from spherejax.output.plot.curves import kind_of_model
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.dry import Dry
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.lubricated import Lubricated
from spherejax.physics.laws.bearings import ShortBearing
from spherejax.physics.laws.cylinders import JohnsonCylinder
from spherejax.physics.laws.elastomer import RadialElastomer
from spherejax.physics.laws.elastomer_axes import HingeElastomer
from spherejax.physics.laws.film import AbstractFilmBoundary
from spherejax.physics.laws.films import AbstractFilm, FullFilm, RadialFilm
from spherejax.physics.laws.friction import (
    AbstractFrictionLaw,
    Ambrosio,
    BengisuAkay,
    BrownMcPhee,
    Threlfall,
)
from spherejax.physics.laws.material import Material
from spherejax.physics.laws.normal import (
    AbstractHysteresisLaw,
    AbstractNormalLaw,
    Flores,
    Gonthier,
    HuntCrossley,
    LankaraniNikravesh,
)

CLEARANCE = 1e-4
"""Clearance of the models where nothing else is said [m]."""

RESTITUTION = 0.9
"""Restitution of normal laws where nothing else is said [-]."""

VISCOSITY = 0.4
"""Dynamic viscosity of the lubricant where nothing else is said [Pa s]: 400 cP."""

STIFFNESS, DAMPING = 1e6, 1e-2
"""Stiffness [N/m] and stiffness-proportional damping [s] of the bushing where nothing else is said."""

CLEARANCE_FACTORS = (0.5, 1.0, 2.0)
"""Clearances of a parameter study, as multiples of the model's: Figs 10, 12 and 15."""

STIFFNESS_FACTORS, DAMPING_FACTORS = (0.1, 1.0, 10.0), (0.01, 0.1, 1.0)
"""The same of a bushing: Figs 16 and 17."""


@dataclass(frozen=True, eq=False)
class Case:
    """One simulation: a model of the studied joint. Two cases with equal models are equal, whatever their labels.

    Attributes:
        label: what the legend says.
        kind: short name of the kind of model: ideal, dry, friction, lubricated or bushing; empty for another one.
        model: the model of the studied joint.
    """

    label: str
    kind: str
    model: AbstractSphericalModel

    def __eq__(self, other) -> bool:
        return isinstance(other, Case) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self):
        # Labels differ from figure to figure; the simulation is the same.
        leaves, structure = jax.tree.flatten(self.model)
        return structure, tuple(leaf if callable(leaf) else np.asarray(leaf).tobytes() for leaf in leaves)


@dataclass(frozen=True)
class Study:
    """Cases that differ in one thing.

    Attributes:
        name: of its figure, e.g. `"dry_clearance"`.
        title: what is varied and what stays.
        of: name of the model that is varied.
        cases: what is compared.
        histories: whether position and velocity are shown as well (Figs 10, 12, 15, 16).
        ordered: whether the cases are values of one number.
        close_up: whether the figure shows the instants near zero sliding.
        of_films: whether the cases are the paper's film and the full one, which have colors of their own.
    """

    name: str
    title: str
    of: str
    cases: tuple[Case, ...]
    histories: bool = False
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


# The models ----------------------------------------------------------------------------------------------------------


def joint_models(
    like: AbstractSphericalModel | None = None,
    *,
    clearance: float | None = None,
    socket_radius: float | None = None,
    length: float | None = None,
    normal: AbstractNormalLaw | None = None,
    friction: AbstractFrictionLaw | None = None,
    material: Material | None = None,
    viscosity: float | None = None,
    film: AbstractFilm | None = None,
    boundary: AbstractFilmBoundary | None = None,
    stiffness: float | None = None,
    damping: float | None = None,
) -> dict[str, AbstractSphericalModel]:
    """The five models of one joint that a comparison is about, with the same numbers wherever they share them.

    Args:
        like: a model whose numbers and laws are taken where nothing else is given, e.g. that of the joint.

    Other args:
        clearance: radial clearance [m]; 0.1 mm by default.
        socket_radius: of the socket or the bearing [m]; 10 mm by default.
        length: of the bearing, where the joint is a revolute one [m]: contact of cylinders by Johnson, the film of a
            short bearing, a bushing that resists tilting by its length.
        normal: normal law of the contact; Lankarani and Nikravesh's with restitution 0.9 by default, and in the
            lubricated joint, where a film damps, Hunt and Crossley's.
        friction: law of friction of the model with friction; Threlfall's by default.
        material: of both bodies; steel by default.
        viscosity: dynamic viscosity [Pa s]; 0.4 by default.
        film: in which directions the film resists; in every one by default.
        boundary: where the film carries pressure; Guembel's condition by default.
        stiffness: of the bushing [N/m]; 1e6 by default.
        damping: of the bushing, proportional to its stiffness [s]; 1e-2 by default.

    Returns:
        Models by the names ideal, dry, friction, lubricated and bushing; the ideal one has no friction.
    """
    base: dict[str, Any] = {}
    if isinstance(like, Dry | Lubricated):
        names = ("clearance", "socket_radius", "normal", "friction", "socket_material", "ball_material", "conformity")
        base = {name: getattr(like, name) for name in names}
    elif isinstance(like, Ideal):
        base = {"friction": like.friction}
    options: dict[str, Any] = {
        "clearance": clearance, "socket_radius": socket_radius, "normal": normal, "friction": friction,
        "socket_material": material, "ball_material": material,
    }  # fmt: skip
    has_length, own_cylinder = length is not None, base.get("conformity")
    if own_cylinder is not None and own_cylinder.is_line_contact:
        length = length if has_length else own_cylinder.length
        options["conformity"] = _with(own_cylinder, "length", length)
    elif length is not None:
        options["conformity"] = JohnsonCylinder(length)
    shared = {"clearance": CLEARANCE, **base, **{name: value for name, value in options.items() if value is not None}}
    rubbing = shared.pop("friction", None)
    # Surfaces that are not round, or worn, stay so in dry contact; a film knows of none.
    shape = {name: getattr(like, name) for name in ("socket_depth", "ball_depth")} if isinstance(like, Dry) else {}
    wet: dict[str, Any] = {"viscosity": VISCOSITY}
    if isinstance(like, Lubricated):
        of_film = ("viscosity", "film", "boundary", "e_h0", "e_h1", "friction", "heat", "thickening")
        wet = {name: getattr(like, name) for name in of_film}
        if clearance is not None:
            del wet["e_h0"], wet["e_h1"]  # shares of the clearance that was
    elif normal is None:
        # A film damps; a law with a restitution would damp the contact behind it twice.
        wet["normal"] = None
    if film is None and length is not None:
        own_film = wet.get("film")
        if own_film is None or not own_film.is_of_bearing:
            film = ShortBearing(length)
        elif has_length:
            film = _with(own_film, "length", length)
    options = {"viscosity": viscosity, "film": film, "boundary": boundary}
    wet |= {name: value for name, value in options.items() if value is not None}
    if isinstance(film, RadialFilm) and normal is None:
        wet["normal"] = LankaraniNikravesh(restitution=RESTITUTION)  # with the paper's film the paper's contact
    bushing = like if isinstance(like, Bushing) and stiffness is None and damping is None else None
    return {
        "ideal": Ideal(),
        "dry": Dry(**shared, **shape),
        "friction": Dry(**shared, **shape, friction=Threlfall() if rubbing is None else rubbing),
        "lubricated": Lubricated(**{**shared, **wet}),
        "bushing": bushing or _bushing(stiffness, damping, length),
    }


def _bushing(stiffness: float | None, damping: float | None, length: float | None) -> Bushing:
    k, b = STIFFNESS if stiffness is None else stiffness, DAMPING if damping is None else damping
    if length is None:
        return Bushing(k, b)
    # A sleeve of the same stiffness at each place along it resists tilting by k L**2/12.
    conical, eye = k * length**2 / 12, jnp.eye(3)
    return Bushing(law=HingeElastomer(k * eye, b * k * eye, conical, b * conical, 0.0))


LABELS = {"friction": "dry with friction"}
"""What a model is called where its name is not enough."""


def cases_of(models: Mapping[str, AbstractSphericalModel]) -> dict[str, Case]:
    """A case for each model, by its name; an ideal one is put in front where there is none.

    Raises:
        SceneError: for what is no model.
    """
    for name, model in models.items():
        if not isinstance(model, AbstractSphericalModel):
            raise SceneError(
                f"models: {name!r} is {model!r}, which is no joint model; give e.g. sj.Dry(clearance=1e-4)"
            )
    ideal = {} if any(model.is_ideal for model in models.values()) else {"ideal": Ideal()}
    return {
        name: Case(LABELS.get(name, name) if kind_of_model(model) == name else name, kind_of_model(model), model)
        for name, model in {**ideal, **models}.items()
    }


def five_models(**numbers: Any) -> dict[str, Case]:
    """The five models of Figs 18 to 25 by short name; the numbers are those of `joint_models`."""
    return cases_of(joint_models(**numbers))


# What follows from them ----------------------------------------------------------------------------------------------


def parameter_studies(models: Mapping[str, Case]) -> list[Study]:
    """What can be varied in the models: clearance, laws, film, stiffness and damping. Of the paper's: Figs 10 to 17."""
    studies = []
    for name, case in models.items():
        of = {"dry": _dry_studies, "friction": _dry_studies, "lubricated": _film_studies, "bushing": _bushing_studies}
        studies += of[case.kind](name, case) if case.kind in of else []
    return studies


def _dry_studies(name: str, case: Case) -> list[Study]:
    model: Any = case.model
    rubbing, law, gap = model.friction, _normal_text(model.normal), _gap(model.clearance)
    what = "Dry joint without friction" if rubbing is None else "Dry joint with friction"
    friction = "" if rubbing is None else f"; {_friction_text(rubbing)}"
    between = " " if rubbing is None else "\n"
    restitution = getattr(model.normal, "restitution", RESTITUTION)
    laws = {_name(law): law(restitution=restitution) for law in (HuntCrossley, LankaraniNikravesh, Gonthier, Flores)}
    factor = f"restitution {restitution:g}"
    studies = [
        Study(f"{name}_clearance", f"{what}: clearance{between}({law}{friction})", name,
              _clearances(case), histories=True, ordered=True),
        Study(f"{name}_normal_law", f"{what}: normal law{between}({gap}, {factor}{friction})", name,
              tuple(Case(label, case.kind, _with(model, "normal", one)) for label, one in laws.items())),
    ]  # fmt: skip
    if rubbing is not None:
        mu = getattr(rubbing, "mu", getattr(rubbing, "mu_kinetic", 0.1))
        static = float(f"{1.5 * mu:.12g}")
        others = (Threlfall(mu), BengisuAkay(mu, static), Ambrosio(mu), BrownMcPhee(mu, static))
        laws = {_name(type(one)): rubbing if type(one) is type(rubbing) else one for one in others}
        studies.append(
            Study(f"{name}_law", f"{what}: friction law ({gap}; {law})", name,
                  tuple(Case(label, case.kind, _with(model, "friction", one)) for label, one in laws.items()),
                  close_up=True)
        )  # fmt: skip
    return studies


def _film_studies(name: str, case: Case) -> list[Study]:
    model: Any = case.model
    oil, where = f"{model.viscosity:g} Pa s", f"{_name(type(model.boundary))}'s condition"
    studies = [
        Study(f"{name}_clearance", f"Lubricated joint: clearance ({film_name(model.film)}; {oil}, {where})", name,
              _clearances(case), histories=True, ordered=True),
    ]  # fmt: skip
    if isinstance(model.film, FullFilm | RadialFilm):
        films = {film_name(film): _with_film(model, film) for film in (RadialFilm(), FullFilm())}
        title = f"Lubricated joint: the paper's film against the full one ({_gap(model.clearance)}; {oil}"
        studies.append(
            Study(f"{name}_films", f"{title}, {_name(type(model.boundary))})", name,
                  tuple(Case(label, case.kind, one) for label, one in films.items()), histories=True, of_films=True)
        )  # fmt: skip
    return studies


def _bushing_studies(name: str, case: Case) -> list[Study]:
    law: Any = getattr(case.model, "law", None)
    if not isinstance(law, RadialElastomer):  # two numbers describe it
        return []
    k, b = float(law.stiffness), float(law.damping)
    stiff = {f"k = {short(f * k)} N/m": _with_bushing(case.model, f * k, b) for f in STIFFNESS_FACTORS}
    damped = {f"b = {short(f * b)} s": _with_bushing(case.model, k, f * b) for f in DAMPING_FACTORS}
    return [
        Study(f"{name}_stiffness", f"Bushing: stiffness k (b = {short(b)} s)", name,
              tuple(Case(label, "bushing", one) for label, one in stiff.items()),
              histories=True, ordered=True),
        Study(f"{name}_damping", f"Bushing: damping b (k = {short(k)} N/m)", name,
              tuple(Case(label, "bushing", one) for label, one in damped.items()),
              ordered=True),
    ]  # fmt: skip


def limit_studies(models: Mapping[str, Case]) -> list[LimitStudy]:
    """The limits in which each model becomes the ideal joint.

    Friction does not vanish with the clearance: the ball is as large as before, and so is the friction moment. The
    full film resists relative spin by 8 pi nu R**4/(3 c), which grows as it carries better: neither limit of the
    lubricated joint is the ideal one, but for the paper's film, which has no moment.
    """
    order = {"friction": 0, "dry": 1, "lubricated": 2, "bushing": 3}
    known = sorted((case for case in models.values() if case.kind in order), key=lambda case: order[case.kind])
    gaps = [_clearance_limit(case) for case in known if case.kind != "bushing"]
    soft = [_stiffness_limit(case) for case in known if isinstance(getattr(case.model, "law", None), RadialElastomer)]
    oils = [limit for case in known if case.kind == "lubricated" for limit in _viscosity_limits(case)]
    return [*gaps, *soft, *oils]


def _clearance_limit(case: Case) -> LimitStudy:
    model: Any = case.model
    factors, order, label = (4.0, 2.0, 1.0, 0.5, 0.25), None, "dry with friction: its moment stays"
    if case.kind == "dry":
        label, order = "dry without friction", 1
    if case.kind == "lubricated":
        label = f"lubricated ({film_name(model.film)}), {model.viscosity:g} Pa s"
        if isinstance(model.film, RadialFilm):
            factors, label = factors[:3], f"{label}\nits curve ends where it rings so fast that runs take long"
    values = tuple(float(f"{1e3 * factor * model.clearance:.12g}") for factor in factors)
    return LimitStudy(label, "clearance [mm]", values, lambda c: _with(model, "clearance", 1e-3 * c), order, case.kind)


def _stiffness_limit(case: Case) -> LimitStudy:
    law: Any = getattr(case.model, "law", None)
    k, b = float(law.stiffness), 0.01 * float(law.damping)
    values = tuple(float(f"{factor * k:.12g}") for factor in (0.01, 0.1, 1.0, 10.0))
    label = f"bushing, b = {short(b)} s"
    return LimitStudy(
        label, "bushing stiffness [N/m]", values, lambda k: _with_bushing(case.model, k, b), -1, case.kind
    )


def _viscosity_limits(case: Case) -> list[LimitStudy]:
    model: Any = case.model
    values = tuple(float(f"{factor * model.viscosity:.12g}") for factor in (0.25, 1.0, 4.0, 16.0))
    films = [(model.film, None)]
    if isinstance(model.film, FullFilm):
        films = [(model.film, None), (RadialFilm(), -1)]
    elif isinstance(model.film, RadialFilm):
        films = [(model.film, -1)]
    return [
        LimitStudy(f"lubricated ({film_name(film)}), {_gap(model.clearance)}", "viscosity [Pa s]", values,
                   lambda nu, film=film: _with(_with_film(model, film), "viscosity", nu), order, case.kind)
        for film, order in films
    ]  # fmt: skip


def _clearances(case: Case) -> tuple[Case, ...]:
    # A transition from film to contact stays as wide as it is: Table 3 has the same at every clearance.
    model: Any = case.model
    gaps = [float(f"{factor * model.clearance:.12g}") for factor in CLEARANCE_FACTORS]
    return tuple(Case(_gap(gap), case.kind, _with(model, "clearance", gap)) for gap in gaps)


def _with(model: Any, name: str, value: Any) -> Any:
    """The model with another number or law."""
    arguments = {**arguments_of(model), name: value}
    if name == "clearance":
        arguments.pop("ball_radius", None)
    return type(model)(**arguments)


def _with_bushing(model: Any, stiffness: float, damping: float) -> Bushing:
    rest = {name: value for name, value in arguments_of(model).items() if name not in ("stiffness", "damping")}
    return Bushing(**{**rest, "law": RadialElastomer(stiffness, damping)})


def _with_film(model: Lubricated, film: AbstractFilm) -> Lubricated:
    """With another film; with the paper's the paper's contact, which a full film would damp twice."""
    if type(film) is type(model.film):
        return model
    usual: Any = Lubricated(CLEARANCE, viscosity=VISCOSITY)
    normal = LankaraniNikravesh(restitution=RESTITUTION) if isinstance(film, RadialFilm) else usual.normal
    return _with(_with(model, "film", film), "normal", normal)


def numbers_of(models: Mapping[str, Case]) -> str:
    """The numbers of the models in a line, for titles."""
    numbers: dict[str, None] = {}
    for case in models.values():
        model: Any = case.model
        if isinstance(model, Dry | Lubricated):
            numbers[_gap(model.clearance)] = None
        if isinstance(model, Dry):
            numbers[_normal_text(model.normal).replace(", restitution", "")] = None
            if model.friction is not None:
                mu = getattr(model.friction, "mu", getattr(model.friction, "mu_kinetic", None))
                numbers[_name(type(model.friction)) + ("" if mu is None else f" mu {mu:g}")] = None
        if isinstance(model, Lubricated):
            film = "" if isinstance(model.film, FullFilm) else f" ({film_name(model.film)})"
            numbers[f"{model.viscosity:g} Pa s{film}"] = None
        law: Any = getattr(model, "law", None)
        if isinstance(law, RadialElastomer):
            numbers[f"k = {short(law.stiffness)} N/m, b = {short(law.damping)} s"] = None
    return ", ".join(numbers)


def film_name(film: AbstractFilm | None) -> str:
    """For titles."""
    if isinstance(film, RadialFilm):
        return "radial film, the paper's"
    return "full film" if film is None or isinstance(film, FullFilm) else f"film of a {_name(type(film)).lower()}"


def _normal_text(law: AbstractNormalLaw) -> str:
    has = isinstance(law, AbstractHysteresisLaw)
    return f"{_name(type(law))}, restitution {law.restitution:g}" if has else _name(type(law))


def _friction_text(law: Any) -> str:
    if isinstance(law, Threlfall):
        return f"Threlfall friction (mu = {law.mu:g}, v1 = {1e3 * law.v1:g} mm/s)"
    return f"{_name(type(law))} friction"


def _name(cls: type) -> str:
    """A law's name for people: `LankaraniNikravesh` is Lankarani-Nikravesh, `BrownMcPhee` Brown-McPhee."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", cls.__name__).replace("Mc-Phee", "McPhee").replace("Short-B", "Short b")


def _gap(clearance: Any) -> str:
    return f"c = {1e3 * float(clearance):.2f} mm" if clearance >= 1e-5 else f"c = {1e6 * float(clearance):.3g} um"


def short(value: Any) -> str:
    """A number with a power of ten and no more digits than it has: 1e6, 2.5e-4."""
    digits = next(n for n in range(4) if n == 3 or float(f"{value:.{n}e}") == float(value))
    mantissa, _, exponent = f"{value:.{digits}e}".partition("e")
    return f"{mantissa}e{int(exponent)}"
