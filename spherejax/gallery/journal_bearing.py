"""A loaded shaft that a motor turns in one bearing: for films, warm oil, soft liners and wear."""

from spherejax.foundations.types import Number
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.applied import AppliedWrench
from spherejax.physics.functions.shapes import Linear
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.drivers import RotationDriver
from spherejax.physics.joints.ideal import Ideal

AXIS = (0.0, 0.0, 1.0)

LENGTH = 0.1
"""Of the shaft, for pictures [m]."""


def journal_bearing(
    model: AbstractSphericalModel | None = None,
    *,
    load: Number = 300.0,
    speed: Number = 300.0,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A shaft that a motor turns steadily about z in its bearing, under a constant load along -y.

    The studied joint is `"bearing"`, revolute: ideal, a bushing, or a journal with clearance, e.g.
    `Lubricated(1e-4, viscosity=0.1, socket_radius=0.02, film=sj.laws.ShortBearing(0.02),
    conformity=sj.laws.JohnsonCylinder(0.02))`, which settles where Ocvirk's film carries the load. The motion begins in
    the middle of the bearing. Body `"shaft"`, driver `"motor"`, force element `"load"`; no gravity.

    Args:
        model: model of the studied joint; ideal by default.

    Other args:
        load: along -y [N].
        speed: of the shaft [rad/s].
        drift: drift control; `PostStabilization()` by default.

    Numbers are of no particular machine.
    """
    ends = {"front": (0.0, 0.0, -LENGTH / 2), "back": (0.0, 0.0, LENGTH / 2)}
    shaft = Body(1.0, (1e-4, 1e-4, 1e-4), angular_velocity=(0.0, 0.0, speed), points=ends)
    joints = {
        "bearing": Revolute((GROUND, "shaft"), (0.0, 0.0, 0.0), AXIS, Ideal() if model is None else model),
        "motor": RotationDriver((GROUND, "shaft"), AXIS, Linear(speed)),
    }
    pull = AppliedWrench("shaft", force=(0.0, -load, 0.0))
    return Scene({"shaft": shaft}, joints, {"load": pull}, gravity=(0.0, 0.0, 0.0), drift=drift)
