"""The right front suspension of a car that passes over a bump: the paper's second mechanism (section 5.2)."""

import numpy as np

from spherejax.foundations.types import Number
from spherejax.model.drift import AbstractDriftControl, Baumgarte
from spherejax.model.scene import Scene
from spherejax.physics.bodies import Body
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.forces.bump_stop import BumpStop
from spherejax.physics.forces.spring_damper import SpringDamper
from spherejax.physics.forces.tyre import Tyre
from spherejax.physics.functions.pieces import Piecewise
from spherejax.physics.functions.shapes import Bump, Linear, Polynomial
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.curves import Circle, PointOnCurve
from spherejax.physics.joints.distance import Distance
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.joint import AbstractJoint
from spherejax.physics.joints.spherical import Spherical

X_AXIS = (1.0, 0.0, 0.0)
UP = (0.0, 0.0, 1.0)

A_ARM_PIVOT, A_ARM_END = (0.0, -0.259, 0.302), (0.0, -0.572, 0.229)
LEAF_PIVOT, LEAF_TIP = (0.0, -0.1585, 0.600), (0.0, -0.488, 0.531)
TIE_ROD_GROUND, TIE_ROD_END = (-0.140, -0.070, 0.600), (-0.140, -0.448, 0.531)
SHOCK_ON_A_ARM, SHOCK_ON_GROUND = (0.075, -0.500, 0.241), (0.075, -0.297, 0.632)
"""Where things are joined at the start, world axes [m]."""

SHOCK_SPRING = Polynomial([-4.0092e6, 2.8397e7, -6.7061e7, 5.2796e7])
"""Tension [N] by length [m], Eq. 42."""

SHOCK_DAMPER = Piecewise(
    [-0.20, 0.21],
    [
        Linear(1844.3, -416.42),
        Polynomial([0.0, 9945.627, 33955.72, -59832.25, -395651.0]),
        Linear(1634.727, 1919.1638),
    ],
)
"""Tension [N] by rate [m/s], Eq. 43; value and slope are continuous at both breaks to the printed digits."""

BUMP = Bump(height=0.2, start=15.0, length=5.0)
"""Height of the road [m] by the way gone [m], Eq. 44."""


def suspension(
    model: AbstractSphericalModel | None = None,
    *,
    speed: Number = 5.0,
    link_mass: Number | None = None,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """Wheel, A-arm, leaf spring and tie rod of a car whose wheel passes over a bump between 3 and 4 s.

    x points forward and z up from the road; the chassis is the ground, and the road passes below. The A-arm and the
    leaf spring turn about x axes on the chassis; the wheel hangs on the A-arm (the studied joint, `"wheel_a_arm"`, with
    the socket on the A-arm), on the leaf spring and on the tie rod. One degree of freedom with ideal joints: the
    wheel's travel. The shock absorber is between A-arm and chassis; the leaf spring presses the wheel down and meets a
    stop at 0.145 m of travel; the tyre is a spring without damping.

    The paper neglects the inertia of leaf spring and tie rod. Here they are massless links: the tie rod keeps two
    points at their distance, the leaf spring keeps its tip on a circle. With `link_mass` they are bodies; as this
    mass goes to zero the motion tends to that of the massless links.

    Args:
        model: model of the studied joint; ideal by default.
        speed: of the car [m/s].
        link_mass: mass of the leaf spring and of the tie rod each [kg], slender rods then, joined by revolute and
            spherical joints; None: massless links.
        drift: drift control; Baumgarte with alpha = beta = 5 1/s by default, as in the paper.

    Returns:
        The scene; the studied joint is concentric at the start, 0.06 mm above the static equilibrium.

    Source: Rodrigues da Silva, Marques, Tavares da Silva, Flores (2022), Multibody Syst. Dyn. 56:221-266, Table 6 and
    Eqs 42 to 44; places, which the paper's Table 5 has, from public models of the Bombardier Iltis benchmark, which
    join leaf spring and tie rod to the wheel (to the A-arm, as the paper's text has it, they would lock).
    """
    bodies = {
        "wheel": Body(
            mass=57.35,
            inertia=(1.2402, 1.908, 1.2402),
            position=(0.0, -0.615, 0.356),
            points={"a_arm": (0.0, 0.043, -0.127), "leaf": (0.0, 0.127, 0.175), "tie_rod": (-0.14, 0.167, 0.175)},
        ),
        "a_arm": _bar(
            A_ARM_PIVOT,
            A_ARM_END,
            mass=6.0,
            inertia=(0.052099, 0.023235, 0.068864),
            names=("pivot", "wheel"),
            points={"shock": SHOCK_ON_A_ARM},
        ),
    }
    joints: dict[str, AbstractJoint] = {
        "a_arm_pivot": Revolute(("ground", "a_arm"), point=A_ARM_PIVOT, axis=X_AXIS),
        "wheel_a_arm": Spherical("a_arm.wheel", "wheel.a_arm", Ideal() if model is None else model),
    }
    tip = "wheel.leaf"
    if link_mass is None:
        radius = np.hypot(*np.subtract(LEAF_TIP, LEAF_PIVOT)[1:])
        joints["leaf_spring"] = PointOnCurve("wheel.leaf", Circle(LEAF_PIVOT, X_AXIS, radius))
        joints["tie_rod"] = Distance("ground.tie_rod", "wheel.tie_rod")
    else:
        tip = "leaf_spring.tip"
        bodies["leaf_spring"] = _rod(LEAF_PIVOT, LEAF_TIP, link_mass, names=("pivot", "tip"))
        bodies["tie_rod"] = _rod(TIE_ROD_GROUND, TIE_ROD_END, link_mass, names=("ground", "wheel"))
        joints |= {
            "leaf_pivot": Revolute(("ground", "leaf_spring"), point=LEAF_PIVOT, axis=X_AXIS),
            "wheel_leaf": Spherical("leaf_spring.tip", "wheel.leaf"),
            "wheel_tie_rod": Spherical("tie_rod.wheel", "wheel.tie_rod"),
            "tie_rod_ground": Spherical("ground.tie_rod", "tie_rod.ground"),
        }
    return Scene(
        bodies,
        joints,
        forces=_forces(tip, speed),
        ground_points={"tie_rod": TIE_ROD_GROUND, "shock": SHOCK_ON_GROUND, "leaf_tip": LEAF_TIP},
        drift=Baumgarte() if drift is None else drift,
    )


def _forces(tip: str, speed: Number) -> dict[str, AbstractForce]:
    """Shock absorber, leaf spring with its stop (upward travel of the tip counts), tyre."""
    return {
        "shock": SpringDamper(("ground.shock", "a_arm.shock"), spring=SHOCK_SPRING, damper=SHOCK_DAMPER),
        "leaf": SpringDamper(("ground.leaf_tip", tip), stiffness=35900.0, free_length=-0.076, direction=UP),
        "stop": BumpStop(("ground.leaf_tip", tip), longest=0.145, stiffness=1e7, direction=UP),
        "tyre": Tyre("wheel", radius=0.36325, stiffness=460e3, road=BUMP, speed=speed),
    }


def _bar(start, end, *, mass: Number, inertia, names: tuple[str, str], points=None) -> Body:
    """A body between two points, which it names; eta points from the end to the start, turned about the x axis.

    All places are in world axes at the start.
    """
    start, end = np.asarray(start), np.asarray(end)
    along, middle = start - end, (start + end) / 2
    angle, half = np.arctan2(along[2], along[1]), np.linalg.norm(along) / 2
    cosine, sine = np.cos(angle), np.sin(angle)
    to_body = np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])
    others = {name: to_body @ (np.asarray(place) - middle) for name, place in (points or {}).items()}
    return Body(
        mass=mass,
        inertia=inertia,
        position=middle,
        quaternion=(np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0),
        points={names[0]: (0.0, half, 0.0), names[1]: (0.0, -half, 0.0), **others},
    )


def _rod(start, end, mass: Number, names: tuple[str, str]) -> Body:
    """A slender uniform rod; about its own axis, where it has none, with a hundredth of its moment of inertia."""
    moment = mass * float(np.sum(np.subtract(start, end) ** 2)) / 12
    return _bar(start, end, mass=mass, inertia=(moment, 0.01 * moment, moment), names=names)
