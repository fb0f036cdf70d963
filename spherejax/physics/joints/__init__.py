"""Joints: where two bodies meet, and the models of how they resist."""

from spherejax.physics.joints.base import AbstractSphericalModel, Crossing, Response
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.dry import Dry
from spherejax.physics.joints.ideal import ConstraintRows, Ideal
from spherejax.physics.joints.lubricated import Lubricated
from spherejax.physics.joints.places import (
    AbstractJoint,
    AbstractPlacedJoint,
    PlacedRevolute,
    PlacedSpherical,
    Revolute,
    Spherical,
)

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
    "PlacedRevolute",
    "PlacedSpherical",
    "Response",
    "Revolute",
    "Spherical",
]
