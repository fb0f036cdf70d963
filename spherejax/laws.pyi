from .foundations.checks import Requirement
from .physics.laws.bearing_heat import BearingHeat
from .physics.laws.bearings import LongBearing, ShortBearing
from .physics.laws.conformity import AbstractConformity, SphericalProfile, WinklerLiner
from .physics.laws.cylinders import EsduCylinder, JohnsonCylinder
from .physics.laws.depth import AbstractDepth, FourierDepth, HarmonicDepth, LegendreFourierDepth
from .physics.laws.elastomer import AbstractElastomer, RadialElastomer, VectorElastomer
from .physics.laws.elastomer_axes import CrossElastomer, HingeElastomer
from .physics.laws.elastomer_curve import CurveElastomer
from .physics.laws.elastomer_matrix import MatrixElastomer
from .physics.laws.film import (
    AbstractFilmBoundary,
    Guembel,
    PinkusSternlicht,
    Sommerfeld,
    film_force,
    hybrid_weight,
    squeeze_coefficient,
    squeeze_factor,
)
from .physics.laws.films import AbstractFilm, FilmAction, FilmGap, FilmMotion, FullFilm, RadialFilm
from .physics.laws.friction import (
    AbstractFrictionLaw,
    AbstractStaticFriction,
    Ambrosio,
    BengisuAkay,
    BrownMcPhee,
    Coulomb,
    LuGre,
    Threlfall,
)
from .physics.laws.full_film import (
    PressurePeak,
    ShearFactors,
    full_sphere_load,
    half_sphere_load,
    pressure_peak,
    shear_factors,
)
from .physics.laws.impact import exact_hysteresis_factor, maximum_penetration, realized_restitution
from .physics.laws.lined import LinedBearing
from .physics.laws.lined_socket import LinedSocket
from .physics.laws.material import Material, generalized_stiffness
from .physics.laws.normal import (
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
from .physics.laws.oil import (
    AbstractOilHeat,
    AbstractOilViscosity,
    HeatFlows,
    OilHeat,
    OilTransport,
    ReynoldsViscosity,
    VogelViscosity,
)
from .physics.laws.pressure import AbstractPressure, CosinePressure, PointContact, PreloadAlone, UniformPressure
from .physics.laws.roelands import RoelandsThickening
from .physics.laws.thickening import AbstractThickening, BarusThickening
from .physics.laws.viscoelastic import Berg, Maxwell
from .physics.memory import MemoryEntry

__all__ = [
    "AbstractConformity",
    "AbstractDepth",
    "AbstractElastomer",
    "AbstractFilm",
    "AbstractFilmBoundary",
    "AbstractFrictionLaw",
    "AbstractHysteresisLaw",
    "AbstractNormalLaw",
    "AbstractOilHeat",
    "AbstractOilViscosity",
    "AbstractPressure",
    "AbstractStaticFriction",
    "AbstractThickening",
    "Ambrosio",
    "BarusThickening",
    "BearingHeat",
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
    "FourierDepth",
    "FullFilm",
    "Gonthier",
    "Guembel",
    "HarmonicDepth",
    "HeatFlows",
    "Hertz",
    "HingeElastomer",
    "HuntCrossley",
    "HuntCrossleyDissipation",
    "JohnsonCylinder",
    "LankaraniNikravesh",
    "LegendreFourierDepth",
    "LinedBearing",
    "LinedSocket",
    "LongBearing",
    "LuGre",
    "Material",
    "MatrixElastomer",
    "Maxwell",
    "MemoryEntry",
    "OilHeat",
    "OilTransport",
    "PinkusSternlicht",
    "PointContact",
    "PreloadAlone",
    "PressurePeak",
    "RadialElastomer",
    "RadialFilm",
    "Requirement",
    "ReynoldsViscosity",
    "RoelandsThickening",
    "ShearFactors",
    "ShortBearing",
    "Sommerfeld",
    "SphericalProfile",
    "Threlfall",
    "UniformPressure",
    "VectorElastomer",
    "VogelViscosity",
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
