"""The spatial four-bar mechanism of the paper (section 5.1, Tables 1 to 3)."""

from spherejax.model.drift import AbstractDriftControl, Baumgarte
from spherejax.model.scene import Scene
from spherejax.physics.bodies import Body
from spherejax.physics.joints.axial import Revolute
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.spherical import Spherical


def four_bar(model: AbstractSphericalModel | None = None, *, drift: AbstractDriftControl | None = None) -> Scene:
    """Crank, coupler and rocker, released from rest under gravity.

    The crank turns about the world's x axis at the origin, the rocker about the y axis at (-0.040, -0.085, 0) m; the
    coupler joins them by two spherical joints. The studied joint is `"coupler_rocker"`, with the socket on the
    coupler. Two degrees of freedom with ideal joints: the crank, and the coupler's idle spin about its own axis.

    Args:
        model: model of the studied joint; ideal by default.
        drift: drift control; Baumgarte with alpha = beta = 5 1/s by default, as in the paper.

    Returns:
        The scene; the studied joint is concentric at the start.

    Source: Rodrigues da Silva, Marques, Tavares da Silva, Flores (2022), Multibody Syst. Dyn. 56:221-266, Tables 1
    and 2. The printed positions and quaternions, rounded to 1e-5, leave a gap of 7e-6 m. Those here close the mechanism
    to the rounding of float64: the rocker's end is where its circle about the y axis, of radius 0.074 m, meets the
    sphere of radius 0.122 m about the crank's pin. The coupler's idle spin is as printed. Moments of inertia as printed
    (ten times those of uniform bodies).
    """
    crank = Body(
        mass=0.0196,
        inertia=(3.92e-5, 1.97e-5, 1.97e-5),
        points={"pivot": (0.0, 0.0, 0.0), "pin": (0.0, 0.0, 0.020)},
    )
    coupler = Body(
        mass=0.1416,
        inertia=(1.7743e-3, 3.51e-5, 1.7743e-3),
        position=(-0.037455577189143066, -0.0425, 0.042623654378286135),
        quaternion=(0.918590834592782, -0.17637622018554283, 0.06746506014109133, -0.34717542138716556),
        points={"crank_end": (0.0, 0.061, 0.0), "rocker_end": (0.0, -0.061, 0.0)},
    )
    rocker = Body(
        mass=0.0316,
        inertia=(1.456e-4, 2.9e-6, 1.456e-4),
        position=(-0.05745557718914307, -0.085, 0.032623654378286134),
        quaternion=(0.363396355078265, -0.6065831263032557, -0.6065831263032557, 0.363396355078265),
        points={"coupler_end": (0.0, -0.037, 0.0), "pivot": (0.0, 0.037, 0.0)},
    )
    return Scene(
        bodies={"crank": crank, "coupler": coupler, "rocker": rocker},
        joints={
            "crank_pivot": Revolute(("ground", "crank"), point=(0.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0)),
            "rocker_pivot": Revolute(("ground", "rocker"), point=(-0.040, -0.085, 0.0), axis=(0.0, 1.0, 0.0)),
            "crank_coupler": Spherical("crank.pin", "coupler.crank_end"),
            "coupler_rocker": Spherical(
                "coupler.rocker_end", "rocker.coupler_end", Ideal() if model is None else model
            ),
        },
        drift=Baumgarte() if drift is None else drift,
    )
