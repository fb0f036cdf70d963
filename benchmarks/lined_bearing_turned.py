"""How much a lined bearing's load depends on where it is against the points, which are fixed in the bearing.

A world, or a bearing, that is turned about the axis moves the load against the points, and with it every number of a
run by what stands here:

    python benchmarks/lined_bearing_turned.py           # five minutes

The journal turns steadily; its place goes from one point to the next in eight steps. A row has the largest change of
the load, as a share of its mean, and of its direction.
"""

from machine import use_one_core, write

use_one_core()

import numpy as np  # noqa: E402
from lined_bearing_axial import film_tests, settled  # noqa: E402

import spherejax as sj  # noqa: E402

COMMAND = "python benchmarks/lined_bearing_turned.py"
POINTS = (16, 24, 32, 64)
RATIOS = (0.3, 0.5, 0.7, 0.8, 0.9)
STEPS = 8


def loads(points: int, axial: int, ratio: float) -> np.ndarray:
    """On the journal along and across its eccentricity [N], at places between two points, shape (STEPS, 2)."""
    film = sj.laws.LinedBearing(film_tests.LENGTH, film_tests.LINER, points, axial=axial)
    rows = []
    for angle in 2 * np.pi / points * np.arange(STEPS) / STEPS:
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        e = tuple(ratio * film_tests.CLEARANCE * along)
        w = settled(film, e, (0.0, 0.0), film_tests.SPEED) * film_tests.CLEARANCE
        motion = film_tests.moving(w, e, (0.0, 0.0), (0.0, film_tests.SPEED))
        force = np.asarray(film.action(motion, film_tests.GAP).force)[:2]
        rows.append((along @ force, across @ force))
    return np.array(rows)


def row(points: int, axial: int, ratio: float) -> dict:
    """Of one number of points at one place."""
    forces = loads(points, axial, ratio)
    sizes, angles = np.linalg.norm(forces, axis=1), np.degrees(np.arctan2(forces[:, 1], forces[:, 0]))
    return {
        "axial": axial,
        "eccentricity_ratio": ratio,
        "points": points,
        "load_percent": round(100 * float(np.abs(sizes / sizes.mean() - 1).max()), 3),
        "direction_deg": round(float(np.abs(angles - angles.mean()).max()), 3),
    }


def main() -> None:
    rows = [row(points, axial, ratio) for axial in (1, 2) for ratio in RATIOS for points in POINTS]
    write("lined_bearing_turned", COMMAND, rows)


if __name__ == "__main__":
    main()
