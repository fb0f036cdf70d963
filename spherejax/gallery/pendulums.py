"""Pendulums: the simple one of the IFToMM library (A01), a physical one on any joint, a double one, and a heavy top."""

from spherejax.foundations.types import Number
from spherejax.gallery.rods import rod_inertia
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import Body
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.distance import Distance
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.spherical import Spherical

ORIGIN = (0.0, 0.0, 0.0)


def simple_pendulum(*, mass: Number = 1.0, length: Number = 1.0, drift: AbstractDriftControl | None = None) -> Scene:
    """A point mass on a massless rod, released from the horizontal, in the x-y plane under gravity -y.

    The mass is `"bob"`, at (-length, 0, 0) at the start; the rod is one equation. One degree of freedom in the plane
    (the motion stays in it). The easiest problem, and a measure of what accuracy costs over ten swings.

    Args:
        mass: [kg].
        length: [m].
        drift: drift control; `PostStabilization()` by default.

    Source: IFToMM library of computational benchmark problems, A01 (1 kg, 1 m, 10 s).
    """
    moment = mass * length * length  # it does not turn
    bob = Body(mass, (moment, moment, moment), (-length, 0.0, 0.0), points={"center": ORIGIN})
    return Scene(
        {"bob": bob},
        {"rod": Distance("ground.pivot", "bob.center", length)},
        gravity=(0.0, -9.81, 0.0),
        ground_points={"pivot": ORIGIN},
        drift=PostStabilization() if drift is None else drift,
    )


def physical_pendulum(
    model: AbstractSphericalModel | None = None,
    *,
    mass: Number = 0.5,
    length: Number = 0.3,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A uniform rod hung by its end from a ball-and-socket joint, released from the horizontal under gravity.

    It swings in the x-z plane. The studied joint is `"pivot"`, with the socket in the ground: any model shows there
    alone what it does to the motion, and for a vanishing clearance or an unyielding elastomer the motion is that of the
    elliptic functions, with the length 2 l / 3 of the simple pendulum that swings as fast.

    Args:
        model: model of the pivot; ideal by default.

    Other args:
        mass: [kg].
        length: l [m].
        drift: drift control; `PostStabilization()` by default.
    """
    rod = _rod(mass, length, (length / 2, 0.0, 0.0))
    return Scene(
        {"rod": rod},
        {"pivot": Spherical("ground.pivot", "rod.start", Ideal() if model is None else model)},
        ground_points={"pivot": ORIGIN},
        drift=PostStabilization() if drift is None else drift,
    )


def double_pendulum(
    model: AbstractSphericalModel | None = None,
    *,
    mass: Number = 0.5,
    length: Number = 0.3,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """Two equal rods, the lower one hung from the upper, released from the horizontal under gravity.

    Both joints are balls in sockets; the studied one is `"elbow"`, between the rods `"upper"` and `"lower"`, with the
    socket on the upper. They swing in the x-z plane. The motion is chaotic: compare histories over short times.

    Args:
        model: model of the elbow; ideal by default.

    Other args:
        mass: of each rod [kg].
        length: of each rod [m].
        drift: drift control; `PostStabilization()` by default.
    """
    bodies = {
        "upper": _rod(mass, length, (0.5 * length, 0.0, 0.0)),
        "lower": _rod(mass, length, (1.5 * length, 0.0, 0.0)),
    }
    joints = {
        "shoulder": Spherical("ground.pivot", "upper.start"),
        "elbow": Spherical("upper.end", "lower.start", Ideal() if model is None else model),
    }
    return Scene(
        bodies,
        joints,
        ground_points={"pivot": ORIGIN},
        drift=PostStabilization() if drift is None else drift,
    )


def heavy_top(
    *,
    spin: Number = 150.0,
    precession: Number = -4.61538,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A fast symmetric top on a ball-and-socket joint, its axis horizontal at the start, under gravity.

    The top is `"top"`; its axis is y at the start. Three degrees of freedom. It precesses and nods: the height z of its
    center obeys, with moments A and C at the tip, E_r the energy without that of the spin and L_z the moment of
    momentum about z,

        (A z' / l)^2 = 2 A (E_r - m g z) (1 - (z / l)^2) - (L_z - C w z / l)^2,

    an elliptic function of time. What is hard: the spin of 24 turns a second, beside which everything else is slow.

    Args:
        spin: angular velocity w about the top's axis [rad/s].
        precession: angular velocity about the vertical z at the start [rad/s]; with the published value the moment of
            momentum about z is -C w, so that the top swings through the point straight below its tip.
        drift: drift control; `PostStabilization()` by default.

    Source: Brüls, Cardona, Arnold (2012), Mech. Mach. Theory 48:121-137 (15 kg, center at 1 m, moments 0.234375 and
    0.46875 kg m^2 about the center).
    """
    top = Body(
        15.0,
        (0.234375, 0.46875, 0.234375),
        (0.0, 1.0, 0.0),
        velocity=(-precession, 0.0, 0.0),
        angular_velocity=(0.0, spin, precession),
        points={"tip": (0.0, -1.0, 0.0)},
    )
    return Scene(
        {"top": top},
        {"tip": Spherical("ground.support", "top.tip")},
        ground_points={"support": ORIGIN},
        drift=PostStabilization() if drift is None else drift,
    )


def _rod(mass: Number, length: Number, center) -> Body:
    """A uniform rod along x, a tenth as thick as it is long, with its ends `start` and `end`."""
    return Body(
        mass,
        rod_inertia(mass, length, 0.1 * length, along=0),
        center,
        points={"start": (-length / 2, 0.0, 0.0), "end": (length / 2, 0.0, 0.0)},
    )
