"""Loads of a ball in a lined cup by numbers of cells, beside the same equation on fine grids.

    python benchmarks/lined_socket_cells.py             # about a quarter of an hour, most of it the fine grids
    python benchmarks/lined_socket_cells.py --cells 10x20

A ball that turns steadily across the axis of its cup, at an eccentricity along the axis or up to 45 degrees from it, in
three oils. The fine grids are those of `tests/test_lined_socket.py`, with 8,192 and 16,200 cells, carried on to ever
finer ones. Where Newton's method doesn't come to an end on them, as with thin films under heavy loads, there is no row.
"""

import argparse
import sys
from pathlib import Path

from machine import use_one_core, write

use_one_core()
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np  # noqa: E402
import test_lined_socket as film_tests  # noqa: E402

import spherejax as sj  # noqa: E402

RATIOS = (0.3, 0.6, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.6)
"""|e|/c."""
TANGENTS = (0.0, 0.5, 1.0)
"""Of the angle of e to the axis."""
VISCOSITIES = (0.005, 0.05, 0.5)
SPIN = (2.0, 0.0, 0.0)
GRIDS = ((64, 128), (90, 180))


def eccentricity(ratio: float, tangent: float) -> np.ndarray:
    return ratio * film_tests.CLEARANCE * np.array([0.0, tangent, 1.0]) / np.hypot(tangent, 1.0)


def exact(ratio: float, tangent: float, viscosity: float) -> np.ndarray | None:
    """Force on the ball [N], by Richardson's rule."""
    try:
        coarse, fine = (
            film_tests.on_grid(eccentricity(ratio, tangent), SPIN, film_tests.K, viscosity, polar=polar, around=around)[
                0
            ]
            for polar, around in GRIDS
        )
    except AssertionError:
        return None
    return fine + (fine - coarse) / ((GRIDS[1][0] / GRIDS[0][0]) ** 2 - 1)


def error(film: sj.laws.LinedSocket, expected: np.ndarray, ratio: float, tangent: float, viscosity: float) -> float:
    """Of the force [%]; negative where the ball is borne too little."""
    gap = film_tests.GAP._replace(viscosity=viscosity)
    action, _ = film_tests.steady(film, eccentricity(ratio, tangent), gap, ((0.0, 0.0, 0.0), SPIN))
    force = np.asarray(action.force)
    sign = np.sign(np.linalg.norm(force) - np.linalg.norm(expected))
    return 100.0 * float(sign * np.linalg.norm(force - expected) / np.linalg.norm(expected))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--cells", nargs="*", default=["6x12", "8x16", "12x24"])
    cells = options.parse_args().cells
    films = {
        name: sj.laws.LinedSocket(film_tests.POLYETHYLENE, rings=rings, around=around)
        for name in cells
        for rings, around in [map(int, name.split("x"))]
    }
    rows = []
    for tangent in TANGENTS:
        for viscosity in VISCOSITIES:
            for ratio in RATIOS:
                case = (ratio, tangent, viscosity)
                expected = exact(*case)
                if expected is None:
                    continue
                errors = {f"error_{name}": round(error(film, expected, *case), 2) for name, film in films.items()}
                load = f"{np.linalg.norm(expected):.4g}"
                rows.append({"ratio": ratio, "tangent": tangent, "viscosity": viscosity, "load": load, **errors})
                print(*rows[-1].values(), flush=True)
    write("lined_socket_cells", "python benchmarks/lined_socket_cells.py", rows)


if __name__ == "__main__":
    main()
