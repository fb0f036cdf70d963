"""Andrews' squeezer: seven bodies in a plane, of the test set for initial value problems."""

import math
from collections.abc import Sequence

from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.applied import AppliedWrench
from spherejax.physics.forces.spring_damper import SpringDamper
from spherejax.physics.joints.axial import Revolute

START = (
    -0.0617138900142764496, 0.0, 0.455279819163070380, 0.222668390165885885, 0.487364979543842550,
    -0.222668390165885885, 1.23054744454982119,
)  # fmt: skip
"""The seven angles beta, Theta, gamma, Phi, delta, Omega, epsilon at the start [rad]."""

MASSES = (0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498)
MOMENTS = (2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5)

A, B, C = (-0.06934, -0.00227), (-0.03635, 0.03273), (0.014, 0.072)
"""The fixed pivots A and B, and the fixed end C of the spring [m]; the crank turns about the origin."""

RR, D, SS, E, ZT, U, ZF = 0.007, 0.028, 0.035, 0.020, 0.040, 0.040, 0.020
"""Lengths between the joints of bodies 1, 2, 3, 4, 5, 7, 6 [m]."""

CENTERS = (
    (0.00092, 0.0), (-0.0115, 0.0), (0.01043, -0.01874), (0.0, 0.01421), (0.02308, 0.00916), (-0.01421, 0.0),
    (-0.01228, -0.00449),
)  # fmt: skip
"""Center of mass of each body from its first joint, body axes [m]."""

SPRING_END = (0.020, -0.018)
"""Moving end of the spring on body 3, from B, body axes [m]."""


def andrews(*, drift: AbstractDriftControl | None = None) -> Scene:
    """Andrews' squeezing mechanism: seven plane bodies, three loops, a stiff spring, driven by a constant torque.

    All bodies `"k1"` to `"k7"` move in the x-y plane without gravity; the crank `"k1"` is driven by 0.033 N m and turns
    two and a half times in 0.03 s. One degree of freedom. Ten revolutes about z: 50 equations for 42 coordinates, nine
    of them redundant. Hard are the time scales (a millisecond a turn, 3e5 rad/s^2) and, for codes that solve the
    index-3 equations as they are, the index.

    The angles of the test set: beta is that of k1, beta + Theta of k2, gamma of k3, Phi + delta of k4, delta of k5,
    Omega + epsilon of k6, epsilon of k7, each of the body's x axis from the world's.

    Args:
        drift: drift control; `PostStabilization()` by default.

    Source: Mazzia and Magherini, Test Set for IVP Solvers (release 2.4), problem Andrews' squeezing mechanism; Hairer
    and Wanner, Solving Ordinary Differential Equations II, section VII.7. Moments of inertia about x and y, which
    do not matter, are those about z.
    """
    beta, theta, gamma, phi, delta, omega, epsilon = START
    angles = (beta, beta + theta, gamma, phi + delta, delta, omega + epsilon, epsilon)
    elbow = _placed((0.0, 0.0), (RR, 0.0), angles[0])
    meeting = _placed(elbow, (-D, 0.0), angles[1])
    fourth = _placed(meeting, (0.0, E), angles[3])
    sixth = _placed(meeting, (-ZF, 0.0), angles[5])
    firsts = ((0.0, 0.0), elbow, B, meeting, A, meeting, A)
    bodies = {
        f"k{i + 1}": _body(MASSES[i], MOMENTS[i], _placed(firsts[i], CENTERS[i], angles[i]), angles[i])
        for i in range(7)
    }
    end = SPRING_END[0] - CENTERS[2][0], SPRING_END[1] - CENTERS[2][1], 0.0
    third = bodies["k3"]
    bodies["k3"] = Body(third.mass, third.inertia, third.position, third.quaternion, points={"spring": end})
    places = {
        (GROUND, "k1"): (0.0, 0.0), (GROUND, "k3"): B, (GROUND, "k5"): A, (GROUND, "k7"): A, ("k1", "k2"): elbow,
        ("k3", "k2"): meeting, ("k3", "k4"): meeting, ("k3", "k6"): meeting, ("k4", "k5"): fourth, ("k6", "k7"): sixth,
    }  # fmt: skip
    return Scene(
        bodies,
        {"_".join(pair): Revolute(pair, (*place, 0.0), (0.0, 0.0, 1.0)) for pair, place in places.items()},
        {
            "drive": AppliedWrench("k1", moment=(0.0, 0.0, 0.033)),
            "spring": SpringDamper(("ground.c", "k3.spring"), stiffness=4530.0, free_length=0.07785),
        },
        gravity=(0.0, 0.0, 0.0),
        ground_points={"c": (*C, 0.0)},
        drift=PostStabilization() if drift is None else drift,
    )


def _placed(origin: Sequence[float], place: Sequence[float], angle: float) -> tuple[float, float]:
    c, s = math.cos(angle), math.sin(angle)
    return origin[0] + c * place[0] - s * place[1], origin[1] + s * place[0] + c * place[1]


def _body(mass: float, moment: float, center: Sequence[float], angle: float) -> Body:
    turned = (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2))
    return Body(mass, (moment, moment, moment), (*center, 0.0), turned)
