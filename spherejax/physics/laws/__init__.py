"""Force laws of one contact: normal, friction, film and elastomer, as in Sect. 4 of the paper.

A law is written once, for one contact, in clear array code; joints are composed of laws.
"""

from spherejax.physics.laws.base import AbstractLaw
from spherejax.physics.laws.bearings import LongBearing, ShortBearing
from spherejax.physics.laws.conformity import (
    AbstractConformity,
    Pair,
    PressedPair,
    SphericalProfile,
    WinklerLiner,
)
from spherejax.physics.laws.cylinders import EsduCylinder, JohnsonCylinder
from spherejax.physics.laws.elastomer import (
    AbstractElastomer,
    AbstractPivotElastomer,
    RadialElastomer,
    VectorElastomer,
)
from spherejax.physics.laws.elastomer_axes import CrossElastomer, HingeElastomer
from spherejax.physics.laws.elastomer_curve import CurveElastomer
from spherejax.physics.laws.elastomer_matrix import MatrixElastomer
from spherejax.physics.laws.film import (
    AbstractFilmBoundary,
    Guembel,
    PinkusSternlicht,
    Sommerfeld,
    film_force,
    hybrid_weight,
    squeeze_coefficient,
    squeeze_factor,
)
from spherejax.physics.laws.films import (
    AbstractFilm,
    FilmAction,
    FilmGap,
    FilmMotion,
    FullFilm,
    RadialFilm,
)
from spherejax.physics.laws.friction import (
    AbstractFrictionLaw,
    AbstractStaticFriction,
    Ambrosio,
    BengisuAkay,
    BrownMcPhee,
    Coulomb,
    LuGre,
    Threlfall,
)
from spherejax.physics.laws.full_film import (
    PressurePeak,
    ShearFactors,
    full_sphere_load,
    half_sphere_load,
    pressure_peak,
    shear_factors,
)
from spherejax.physics.laws.impact import (
    exact_hysteresis_factor,
    maximum_penetration,
    realized_restitution,
)
from spherejax.physics.laws.material import Material, generalized_stiffness
from spherejax.physics.laws.normal import (
    MINIMUM_ONSET_RATE,
    AbstractHysteresisLaw,
    AbstractNormalLaw,
    ExactRestitution,
    Flores,
    Gonthier,
    Hertz,
    HuntCrossley,
    HuntCrossleyDissipation,
    LankaraniNikravesh,
)
from spherejax.physics.laws.pressure import (
    AbstractPressure,
    CosinePressure,
    PointContact,
    PreloadAlone,
    UniformPressure,
)
from spherejax.physics.laws.viscoelastic import Berg, Maxwell

__all__ = [
    "MINIMUM_ONSET_RATE",
    "AbstractConformity",
    "AbstractElastomer",
    "AbstractFilm",
    "AbstractFilmBoundary",
    "AbstractFrictionLaw",
    "AbstractHysteresisLaw",
    "AbstractLaw",
    "AbstractNormalLaw",
    "AbstractPivotElastomer",
    "AbstractPressure",
    "AbstractStaticFriction",
    "Ambrosio",
    "BengisuAkay",
    "Berg",
    "BrownMcPhee",
    "CosinePressure",
    "Coulomb",
    "CrossElastomer",
    "CurveElastomer",
    "EsduCylinder",
    "ExactRestitution",
    "FilmAction",
    "FilmGap",
    "FilmMotion",
    "Flores",
    "FullFilm",
    "Gonthier",
    "Guembel",
    "Hertz",
    "HingeElastomer",
    "HuntCrossley",
    "HuntCrossleyDissipation",
    "JohnsonCylinder",
    "LankaraniNikravesh",
    "LongBearing",
    "LuGre",
    "Material",
    "MatrixElastomer",
    "Maxwell",
    "Pair",
    "PinkusSternlicht",
    "PointContact",
    "PreloadAlone",
    "PressedPair",
    "PressurePeak",
    "RadialElastomer",
    "RadialFilm",
    "ShearFactors",
    "ShortBearing",
    "Sommerfeld",
    "SphericalProfile",
    "Threlfall",
    "UniformPressure",
    "VectorElastomer",
    "WinklerLiner",
    "exact_hysteresis_factor",
    "film_force",
    "full_sphere_load",
    "generalized_stiffness",
    "half_sphere_load",
    "hybrid_weight",
    "maximum_penetration",
    "pressure_peak",
    "realized_restitution",
    "shear_factors",
    "squeeze_coefficient",
    "squeeze_factor",
]
