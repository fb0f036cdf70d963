"""Joints: where two bodies meet, and the models of how they resist."""

from spherejax.physics.joints.axial import Cylindrical, Prismatic, Revolute
from spherejax.physics.joints.base import PART_UNITS, AbstractSphericalModel, Crossing, Reaction, Response
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.curves import AbstractCurve, Circle, ImplicitCurve, Line, PointOnCurve
from spherejax.physics.joints.distance import Distance, DistanceDriver
from spherejax.physics.joints.drivers import PositionDriver, RotationDriver, TranslationDriver
from spherejax.physics.joints.dry import Dry
from spherejax.physics.joints.elementary import PlacedPair
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.joint import AbstractJoint, AbstractPlacedJoint, Motions
from spherejax.physics.joints.lubricated import Lubricated
from spherejax.physics.joints.pairs import Fixed, PointOnPlane, Universal
from spherejax.physics.joints.reaction_friction import AbstractJointFriction, Resistance
from spherejax.physics.joints.rim import Rim, tilting_journal
from spherejax.physics.joints.rows import ConstraintRows, differentiated_rows
from spherejax.physics.joints.spherical import PlacedSpherical, Spherical

__all__ = [
    "PART_UNITS",
    "AbstractCurve",
    "AbstractJoint",
    "AbstractJointFriction",
    "AbstractPlacedJoint",
    "AbstractSphericalModel",
    "Bushing",
    "Circle",
    "ConstraintRows",
    "Crossing",
    "Cylindrical",
    "Distance",
    "DistanceDriver",
    "Dry",
    "Fixed",
    "Ideal",
    "ImplicitCurve",
    "Line",
    "Lubricated",
    "Motions",
    "PlacedPair",
    "PlacedSpherical",
    "PointOnCurve",
    "PointOnPlane",
    "PositionDriver",
    "Prismatic",
    "Reaction",
    "Resistance",
    "Response",
    "Revolute",
    "Rim",
    "RotationDriver",
    "Spherical",
    "TranslationDriver",
    "Universal",
    "differentiated_rows",
    "tilting_journal",
]
