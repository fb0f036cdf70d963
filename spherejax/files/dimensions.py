"""What each argument of each class holds, with its unit: the one table by which files are read, checked and written.

An argument that is missing here cannot be written in a file; a test compares the table with every public class.
"""

from collections.abc import Mapping

from spherejax.files.fields import (
    BodyName,
    BodyNames,
    Either,
    Field,
    Part,
    Plain,
    PointName,
    Points,
    Quantity,
    listed,
    matrix,
    number,
    vector,
)
from spherejax.model.drift import Baumgarte, NoDriftControl, PostStabilization, Projection
from spherejax.physics import forces, joints, laws
from spherejax.physics.bodies import Body

Fields = Mapping[str, Field]

BODY: Fields = {
    "mass": number("kg"),
    "inertia": Quantity("kg m^2", ((3,), (3, 3))),
    "position": vector("m"),
    "quaternion": Quantity("1", ((4,),)),
    "velocity": vector("m/s"),
    "angular_velocity": vector("rad/s"),
    "points": Points(),
}

_CONTACT: Fields = {
    "clearance": number("m"),
    "socket_radius": number("m"),
    "ball_radius": number("m"),
    "normal": Part(laws.AbstractNormalLaw),
    "friction": Part(laws.AbstractFrictionLaw),
    "socket_material": Part(laws.Material),
    "ball_material": Part(laws.Material),
}

_NORMAL: Fields = {"stiffness": number("N/m^{exponent}"), "exponent": number("1")}

_HYSTERESIS: Fields = {"restitution": number("1"), **_NORMAL}

JOINTS: Mapping[type, Fields] = {
    joints.Spherical: {
        "socket": PointName(),
        "ball": PointName(),
        "model": Part(joints.AbstractSphericalModel),
        "starts_concentric": Plain(bool),
    },
    joints.Revolute: {"bodies": BodyNames(), "point": vector("m"), "axis": vector("1")},
}

MODELS: Mapping[type, Fields] = {
    joints.Ideal: {},
    joints.Dry: _CONTACT,
    joints.Lubricated: {
        **_CONTACT,
        "viscosity": number("Pa s"),
        "e_h0": number("m"),
        "e_h1": number("m"),
        "boundary": Part(laws.AbstractFilmBoundary),
    },
    joints.Bushing: {"stiffness": number("N/m"), "damping": number("s"), "law": Part(laws.AbstractElastomer)},
}

LAWS: Mapping[type, Fields] = {
    laws.Hertz: _NORMAL,
    laws.HuntCrossley: _HYSTERESIS,
    laws.LankaraniNikravesh: _HYSTERESIS,
    laws.Gonthier: _HYSTERESIS,
    laws.Flores: _HYSTERESIS,
    laws.ExactRestitution: _HYSTERESIS,
    laws.Coulomb: {"mu": number("1")},
    laws.Threlfall: {"mu": number("1"), "v1": number("m/s")},
    laws.BengisuAkay: {
        "mu_kinetic": number("1"),
        "mu_static": number("1"),
        "v0": number("m/s"),
        "kappa": number("s/m"),
    },
    laws.Ambrosio: {"mu": number("1"), "v0": number("m/s"), "v1": number("m/s")},
    laws.BrownMcPhee: {"mu_kinetic": number("1"), "mu_static": number("1"), "stribeck_velocity": number("m/s")},
    laws.LuGre: {
        "mu_kinetic": number("1"),
        "mu_static": number("1"),
        "stribeck_velocity": number("m/s"),
        "bristle_stiffness": number("1/m"),
        "bristle_damping": number("s/m"),
        "viscous": number("s/m"),
    },
    laws.Guembel: {},
    laws.PinkusSternlicht: {},
    laws.Sommerfeld: {},
    laws.Material: {"youngs_modulus": number("Pa"), "poissons_ratio": number("1")},
    laws.RadialElastomer: {"stiffness": number("N/m"), "damping": number("s")},
    laws.VectorElastomer: {"stiffness": number("N/m"), "damping": number("s")},
    laws.MatrixElastomer: {
        "stiffness": matrix("N/m"),
        "damping": matrix("N s/m"),
        "rotational_stiffness": matrix("N m/rad"),
        "rotational_damping": matrix("N m s/rad"),
    },
    laws.CurveElastomer: {"deflections": listed("m"), "forces": listed("N"), "damping": number("s")},
}

FORCES: Mapping[type, Fields] = {
    forces.AppliedWrench: {
        "body": BodyName(),
        "force": vector("N"),
        "moment": vector("N m"),
        "place": vector("m"),
        "in_body_axes": Plain(bool),
    },
}

DRIFT_CONTROLS: Mapping[type, Fields] = {
    Baumgarte: {"alpha": number("1/s"), "beta": number("1/s")},
    NoDriftControl: {},
    PostStabilization: {},
    Projection: {},
}

FIELDS: Mapping[type, Fields] = {Body: BODY, **JOINTS, **MODELS, **LAWS, **FORCES, **DRIFT_CONTROLS}

__all__ = ["FIELDS", "Either", "Fields"]
