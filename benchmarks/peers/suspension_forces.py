"""The suspension's forces in Exudyn, written anew from the paper's Eqs 42 to 44: shock absorber, leaf spring, tyre."""

from collections.abc import Mapping

import numpy as np

from peers.started import Start

SHOCK_ON_GROUND, SHOCK_ON_A_ARM = [0.075, -0.297, 0.632], [0.075, -0.087856, -0.004667]
LEAF_ON_WHEEL = [0.0, 0.127, 0.175]
SPEED, UNLOADED_RADIUS, TYRE = 5.0, 0.36325, 460e3


def shock(x: float, rate: float) -> float:
    """Tension [N] by length [m] and rate [m/s], Eqs 42 and 43."""
    spring = -4.0092e6 + 2.8397e7 * x - 6.7061e7 * x**2 + 5.2796e7 * x**3
    if rate < -0.2:
        return spring + 1844.3 * rate - 416.42
    if rate > 0.21:
        return spring + 1634.727 * rate + 1919.1638
    return spring + 9945.627 * rate + 33955.72 * rate**2 - 59832.25 * rate**3 - 395651.0 * rate**4


def road(x: float) -> float:
    """Height [m] of the bump, Eq. 44."""
    return 0.2 * (1 - np.cos(2 * np.pi * (x - 15) / 5)) / 2 if 15 < x < 20 else 0.0


def add(model, numbers: Mapping[str, object], start: Start) -> None:
    """Add the forces to Exudyn's model."""
    import exudyn as exu

    wheel, arm, ground = numbers["wheel"], numbers["a_arm"], numbers["ground"]
    tip = start.poses["wheel"].point(LEAF_ON_WHEEL)[2]
    length = float(np.linalg.norm(start.poses["a_arm"].point(SHOCK_ON_A_ARM) - SHOCK_ON_GROUND))

    def at(mbs, body, place):
        return mbs.GetObjectOutputBody(body, exu.OutputVariableType.Position, localPosition=place)

    def tyre(mbs, t, load):
        z = at(mbs, wheel, [0, 0, 0])
        return [0, 0, TYRE * max(0.0, UNLOADED_RADIUS - (z[2] - road(SPEED * t + z[0])))]

    def leaf(mbs, t, load):
        travel = at(mbs, wheel, LEAF_ON_WHEEL)[2] - tip
        return [0, 0, -35900.0 * (0.076 + travel) - 1e7 * max(0.0, travel - 0.145)]

    def pull(mbs, t, item, u, v, k, d, offset):
        return shock(length + u, v)

    model.CreateSpringDamper(
        itemNumbers=[ground, arm],
        localPosition0=SHOCK_ON_GROUND,
        localPosition1=SHOCK_ON_A_ARM,
        referenceLength=length,
        springForceUserFunction=pull,
    )
    model.CreateForce(itemNumber=wheel, loadVectorUserFunction=tyre)
    model.CreateForce(itemNumber=wheel, localPosition=LEAF_ON_WHEEL, loadVectorUserFunction=leaf)
