from .foundations.checks import Requirement
from .physics.joints.axial import Cylindrical, Prismatic, Revolute
from .physics.joints.base import AbstractSphericalModel, Response
from .physics.joints.bushing import Bushing
from .physics.joints.curves import AbstractCurve, Circle, ImplicitCurve, Line, PointOnCurve
from .physics.joints.distance import Distance, DistanceDriver
from .physics.joints.drivers import PositionDriver, RotationDriver, TranslationDriver
from .physics.joints.dry import Dry
from .physics.joints.ideal import Ideal
from .physics.joints.joint import AbstractJoint, AbstractPlacedJoint
from .physics.joints.lubricated import Lubricated
from .physics.joints.orientation import ParallelAxes, PerpendicularAxes, SameOrientation
from .physics.joints.pairs import Fixed, PointOnPlane, Universal
from .physics.joints.rim import Rim, tilting_journal
from .physics.joints.rows import ConstraintRows, differentiated_rows
from .physics.joints.spherical import Spherical
from .physics.memory import MemoryEntry

__all__ = [
    "AbstractCurve",
    "AbstractJoint",
    "AbstractPlacedJoint",
    "AbstractSphericalModel",
    "Bushing",
    "Circle",
    "ConstraintRows",
    "Cylindrical",
    "Distance",
    "DistanceDriver",
    "Dry",
    "Fixed",
    "Ideal",
    "ImplicitCurve",
    "Line",
    "Lubricated",
    "MemoryEntry",
    "ParallelAxes",
    "PerpendicularAxes",
    "PointOnCurve",
    "PointOnPlane",
    "PositionDriver",
    "Prismatic",
    "Requirement",
    "Response",
    "Revolute",
    "Rim",
    "RotationDriver",
    "SameOrientation",
    "Spherical",
    "TranslationDriver",
    "Universal",
    "differentiated_rows",
    "tilting_journal",
]
