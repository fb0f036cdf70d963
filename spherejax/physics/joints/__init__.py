"""Joints: where two bodies meet, and the models of how they resist."""

from spherejax.physics.joints.base import AbstractSphericalModel, Crossing, Response
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.dry import Dry
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.lubricated import Lubricated
from spherejax.physics.joints.places import AbstractJoint, AbstractPlacedJoint, Motions
from spherejax.physics.joints.revolute import PlacedRevolute, Revolute
from spherejax.physics.joints.rows import ConstraintRows, differentiated_rows
from spherejax.physics.joints.spherical import PlacedSpherical, Spherical

__all__ = [
    "AbstractJoint",
    "AbstractPlacedJoint",
    "AbstractSphericalModel",
    "Bushing",
    "ConstraintRows",
    "Crossing",
    "Dry",
    "Ideal",
    "Lubricated",
    "Motions",
    "PlacedRevolute",
    "PlacedSpherical",
    "Response",
    "Revolute",
    "Spherical",
    "differentiated_rows",
]
