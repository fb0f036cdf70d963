"""What each argument of each class holds, with its unit: the one table by which files are read, checked and written.

An argument that is missing here cannot be written in a file; a test compares the table with every public class.
"""

from collections.abc import Mapping

from spherejax.files.fields import Field, Plain
from spherejax.files.names import BodyName, BodyNames, End, Ends, PointName, PointOrPlace
from spherejax.files.parts import Either, OwnFunction, Part, Parts
from spherejax.files.quantities import Coefficients, Points, Quantity, listed, matrix, number, vector
from spherejax.model.drift import Baumgarte, NoDriftControl, PostStabilization, Projection
from spherejax.physics import forces, functions, joints, laws
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
    "reference_position": vector("m"),
    "reference_quaternion": Quantity("1", ((4,),)),
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

_MODEL = Part(joints.AbstractSphericalModel)

_AXIAL: Fields = {
    "bodies": BodyNames(),
    "point": PointOrPlace(),
    "axis": vector("1"),
    "model": _MODEL,
    "starts_concentric": Plain(bool),
}


def _function(argument: str, value: str) -> Part:
    """A function of one number, with the units of its argument and its value."""
    return Part(functions.AbstractFunction, argument, value)


JOINTS: Mapping[type, Fields] = {
    joints.Spherical: {
        "socket": PointName(),
        "ball": PointName(),
        "model": _MODEL,
        "starts_concentric": Plain(bool),
    },
    joints.Revolute: _AXIAL,
    joints.Cylindrical: _AXIAL,
    joints.Prismatic: _AXIAL,
    joints.Universal: {
        "bodies": BodyNames(),
        "point": PointOrPlace(),
        "first_axis": vector("1"),
        "second_axis": vector("1"),
        "model": _MODEL,
        "starts_concentric": Plain(bool),
    },
    joints.Fixed: {
        "bodies": BodyNames(),
        "point": PointOrPlace(),
        "model": _MODEL,
        "starts_concentric": Plain(bool),
    },
    joints.PointOnPlane: {
        "point": PointName(),
        "through": PointOrPlace(),
        "normal": vector("1"),
        "body": BodyName(),
    },
    joints.PointOnCurve: {"point": PointName(), "curve": Part(joints.AbstractCurve), "body": BodyName()},
    joints.Distance: {"first": PointName(), "second": PointName(), "length": number("m")},
    joints.DistanceDriver: {"first": PointName(), "second": PointName(), "length": _function("s", "m")},
    joints.RotationDriver: {"bodies": BodyNames(), "axis": vector("1"), "angle": _function("s", "rad")},
    joints.TranslationDriver: {
        "bodies": BodyNames(),
        "point": PointOrPlace(),
        "axis": vector("1"),
        "travel": _function("s", "m"),
    },
    joints.PositionDriver: {"point": PointName(), "position": Part(OwnFunction), "body": BodyName()},
}

CURVES: Mapping[type, Fields] = {
    joints.Circle: {"center": vector("m"), "axis": vector("1"), "radius": number("m")},
    joints.Line: {"through": vector("m"), "direction": vector("1")},
    joints.ImplicitCurve: {"function": Part(OwnFunction)},
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
        "film": Part(laws.AbstractFilm),
    },
    joints.Bushing: {"stiffness": number("N/m"), "damping": number("s"), "law": Part(laws.AbstractElastomer)},
}

_TRANSLATION: Fields = {"stiffness": matrix("N/m"), "damping": matrix("N s/m")}

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
    laws.RadialFilm: {},
    laws.FullFilm: {},
    laws.Guembel: {},
    laws.PinkusSternlicht: {},
    laws.Sommerfeld: {},
    laws.Material: {"youngs_modulus": number("Pa"), "poissons_ratio": number("1")},
    laws.RadialElastomer: {"stiffness": number("N/m"), "damping": number("s")},
    laws.VectorElastomer: {"stiffness": number("N/m"), "damping": number("s")},
    laws.MatrixElastomer: {
        **_TRANSLATION,
        "rotational_stiffness": matrix("N m/rad"),
        "rotational_damping": matrix("N m s/rad"),
    },
    laws.HingeElastomer: {
        **_TRANSLATION,
        "conical_stiffness": number("N m/rad"),
        "conical_damping": number("N m s/rad"),
        "torsional_damping": number("N m s/rad"),
    },
    laws.CrossElastomer: {
        **_TRANSLATION,
        "torsional_stiffness": number("N m/rad"),
        "torsional_damping": number("N m s/rad"),
    },
    laws.CurveElastomer: {"deflections": listed("m"), "forces": listed("N"), "damping": number("s")},
}

_LINE: Fields = {"ends": Ends(), "direction": vector("1")}

_ONE_SIDED: Fields = {
    "stiffness": number("N/m"),
    "damping": number("N s/m"),
    "onset": number("m"),
    "spring": _function("m", "N"),
    "damper": _function("m/s", "N"),
}

FORCES: Mapping[type, Fields] = {
    forces.AppliedWrench: {
        "body": End(),
        "force": Either(vector("N"), Part(OwnFunction)),
        "moment": Either(vector("N m"), Part(OwnFunction)),
        "place": vector("m"),
        "in_body_axes": Plain(bool),
    },
    forces.SpringDamper: {
        **_LINE,
        "stiffness": number("N/m"),
        "damping": number("N s/m"),
        "free_length": number("m"),
        "spring": _function("m", "N"),
        "damper": _function("m/s", "N"),
        "law": Part(OwnFunction),
    },
    forces.ShockAbsorber: {
        **_LINE,
        "compression": _function("m/s", "N"),
        "extension": _function("m/s", "N"),
        "spring": _function("m", "N"),
        "free_length": number("m"),
        "transition": number("m/s"),
    },
    forces.BumpStop: {**_LINE, "shortest": number("m"), "longest": number("m"), **_ONE_SIDED},
    forces.TorsionalSpring: {
        "bodies": BodyNames(),
        "axis": vector("1"),
        "stiffness": number("N m/rad"),
        "damping": number("N m s/rad"),
        "free_angle": number("rad"),
        "spring": _function("rad", "N m"),
        "damper": _function("rad/s", "N m"),
    },
    forces.Tyre: {
        "center": End(),
        "radius": number("m"),
        **_ONE_SIDED,
        "road": _function("m", "m"),
        "speed": number("m/s"),
        "normal_to_road": Plain(bool),
    },
}

DRIFT_CONTROLS: Mapping[type, Fields] = {
    Baumgarte: {"alpha": number("1/s"), "beta": number("1/s")},
    NoDriftControl: {},
    PostStabilization: {},
    Projection: {},
}

_ARGUMENT, _VALUE = number("{of_argument}"), number("{of_value}")

FUNCTIONS: Mapping[type, Fields] = {
    functions.Constant: {"value": _VALUE},
    functions.Linear: {"slope": number("({of_value})/({of_argument})"), "offset": _VALUE},
    functions.Polynomial: {"coefficients": Coefficients(), "center": _ARGUMENT},
    functions.Sine: {
        "amplitude": _VALUE,
        "frequency": number("1/({of_argument})"),
        "phase": number("rad"),
        "offset": _VALUE,
    },
    functions.Step: {"at": _ARGUMENT, "before": _VALUE, "after": _VALUE},
    functions.SmoothStep: {"start": _ARGUMENT, "end": _ARGUMENT, "before": _VALUE, "after": _VALUE},
    functions.Bump: {"height": _VALUE, "start": _ARGUMENT, "length": _ARGUMENT},
    functions.Table: {"x": listed("{of_argument}"), "y": listed("{of_value}")},
    functions.SmoothTable: {"x": listed("{of_argument}"), "y": listed("{of_value}")},
    functions.Piecewise: {"breaks": listed("{of_argument}"), "pieces": Parts(functions.AbstractFunction)},
    functions.Sum: {"terms": Parts(functions.AbstractFunction)},
}

FIELDS: Mapping[type, Fields] = {
    Body: BODY,
    **JOINTS,
    **CURVES,
    **MODELS,
    **LAWS,
    **FORCES,
    **FUNCTIONS,
    **DRIFT_CONTROLS,
}
