"""Loads of a journal in a lined bearing by deflections along half of the axis, and what these cost.

Beside fine grids and published tables, with 32 and 64 points round the bearing:

    python benchmarks/lined_bearing_axial.py            # five minutes

The fine grids are those of `tests/test_lined_bearing.py`, carried on to ever finer ones; where Newton's method doesn't
come to an end on them, as in the softest liners, there is no row. A liner is stated by its compliance, the deflection
by the unit of pressure 6 eta speed (R/c)**2 in clearances. The tables are Butenschoen's (1976), of hard bearings.
"""

import math
import sys
import time
from pathlib import Path

from machine import use_one_core, write

use_one_core()
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import test_lined_bearing as film_tests  # noqa: E402

import spherejax as sj  # noqa: E402

COMMAND = "python benchmarks/lined_bearing_axial.py"
KINDS = ((1, 32), (1, 64), (2, 32), (2, 64), (3, 32), (3, 64))
"""Deflections along half of the axis, and points."""
SLENDERNESSES = (0.25, 0.5, 1.0, 2.0, 4.0)
RATIOS = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
HARD = 1e-6
COMPLIANCES = (HARD, 0.03, 0.1, 0.3)
GRIDS = ((200, 20), (300, 30))


def exact(ratio: float, compliance: float, slenderness: float) -> np.ndarray | None:
    """Load and largest pressure, by Richardson's rule."""
    try:
        with np.errstate(all="ignore"):
            coarse, fine = (np.append(*film_tests.on_grid(ratio, compliance, slenderness, *size)) for size in GRIDS)
    except (AssertionError, RuntimeError):
        return None
    result = fine + (fine - coarse) / ((GRIDS[1][0] / GRIDS[0][0]) ** 2 - 1)
    return result if np.isfinite(result).all() else None


def settled(film: sj.laws.LinedBearing, e: tuple, rate: tuple, speed: float) -> np.ndarray:
    """Deflections that stay, in clearances, by implicit steps that grow: Newton's method alone may go astray."""
    numbers = jax.tree.map(jnp.asarray, (e, film_tests.GAP, rate, speed))
    film = jax.tree.map(jnp.asarray, film)
    clearance = film_tests.CLEARANCE
    w, step, change = np.zeros(len(film.memory)), 1e-6, np.inf
    for _ in range(1000):
        slope = np.asarray(film_tests.slope_of(film, w * clearance, *numbers))
        rates = np.asarray(film_tests.rates_of(film, w * clearance, *numbers)) / clearance
        change = np.linalg.solve(np.eye(w.size) / step - slope, rates)
        size = max(np.abs(w).max(), 1e-9)
        if not np.abs(change).max() < max(0.3, 0.2 * size):
            step = step / 2.0
            continue
        w, step = w + change, min(1.7 * step, 1e8)
        if step == 1e8 and np.abs(change).max() < 1e-9 * size:
            return w
    raise AssertionError(f"no steady film, last change {np.abs(change).max():.1e}")


def steady(film: sj.laws.LinedBearing, e: tuple, rate: tuple = (0.0, 0.0), speed: float = film_tests.SPEED) -> tuple:
    """Action and largest pressure [Pa]."""
    w = jnp.asarray(settled(film, e, rate, speed)) * film_tests.CLEARANCE
    motion = film_tests.moving(w, e, rate, (0.0, speed))
    return film.action(motion, film_tests.GAP), float(film.pressure_peak(motion, film_tests.GAP).height)


def percent(value: float, expected: float) -> float:
    return round(100.0 * float(value / expected - 1.0), 2)


def beside_grids() -> None:
    rows = []
    for slenderness in SLENDERNESSES:
        length = 2 * film_tests.RADIUS * slenderness
        for compliance in COMPLIANCES:
            liner = film_tests.liner_of(compliance)
            for ratio in RATIOS:
                expected = exact(ratio, compliance, slenderness)
                if expected is None:
                    continue
                row = {"length_over_diameter": slenderness, "compliance": compliance, "ratio": ratio}
                for axial, points in KINDS:
                    film = sj.laws.LinedBearing(length, liner, points, axial=axial)
                    action, peak = steady(film, (ratio * film_tests.CLEARANCE, 0.0))
                    load = np.linalg.norm(film_tests.load_of(action, length))
                    row[f"load_{axial}x{points}"] = percent(load, np.linalg.norm(expected[:2]))
                    row[f"peak_{axial}x{points}"] = percent(peak / film_tests.PRESSURE, expected[2])
                rows.append(row)
                print(*row.values(), flush=True)
    write("lined_bearing_axial", COMMAND, rows)


def beside_tables() -> None:
    hard, clearance, speed = sj.laws.WinklerLiner(2e13, 0.4, 1e-3), film_tests.CLEARANCE, film_tests.SPEED
    rows = []
    for kind, table in (("turning", film_tests.TURNING), ("squeezed", film_tests.SQUEEZED)):
        for ratio, entry in table.items():
            numbers = entry[0] if kind == "turning" else entry
            for column, slenderness in enumerate(film_tests.SLENDERNESSES):
                length, number = 2 * film_tests.RADIUS * slenderness, numbers[column]
                row = {"kind": kind, "length_over_diameter": round(slenderness, 3), "ratio": ratio}
                for axial, points in KINDS[:4]:
                    film, name = sj.laws.LinedBearing(length, hard, points, axial=axial), f"{axial}x{points}"
                    if kind == "squeezed":
                        rate = (math.copysign(1e-3, ratio), 0.0)
                        action, _ = steady(film, (abs(ratio) * clearance, 0.0), rate, 0.0)
                        row[f"load_{name}"] = percent(film_tests.sommerfeld(action, length, 1e-3 / clearance), number)
                        continue
                    action, _ = steady(film, (ratio * clearance, 0.0))
                    row[f"load_{name}"] = percent(film_tests.sommerfeld(action, length, speed), number)
                    attitude = math.radians(entry[1][column])
                    friction = math.pi / (math.sqrt(1 - ratio**2) * number) + 0.5 * ratio * math.sin(attitude)
                    power = float(action.pressure_power + action.shear_power)
                    coefficient = power / (speed * float(jnp.linalg.norm(action.force)) * clearance)
                    row[f"friction_{name}"] = percent(coefficient, friction)
                    force = -np.asarray(action.force)
                    angle = math.atan2(abs(force[1]), force[0]) - attitude
                    row[f"attitude_{name}"] = round(math.degrees(angle), 2)
                rows.append(row)
                print(*row.values(), flush=True)
    columns = list(rows[0])
    write("lined_bearing_tables", COMMAND, [{name: row.get(name, "") for name in columns} for row in rows])


def costs() -> None:
    """Of the journal of the page on soft bearings: states and operations of the liner, first call and run."""
    rows = []
    for axial, points in ((1, 16), (1, 32), (1, 64), (2, 16), (2, 32), (2, 64), (3, 32)):
        film = sj.laws.LinedBearing(0.02, sj.laws.WinklerLiner(5e7, 0.45, 2e-3), points, axial=axial)
        model = sj.Lubricated(1e-4, 0.05, socket_radius=0.02, film=film, conformity=sj.laws.JohnsonCylinder(0.02))
        scene = film_tests.journal(model)
        *_, rigid, lined = sj.effects(scene, timed=False).rows
        row = {"axial": axial, "points": points, "states": lined.n_states - rigid.n_states}
        row["operations"] = lined.n_operations - rigid.n_operations
        for name in ("first_cpu_s", "again_cpu_s"):
            begin = time.process_time()
            run = sj.simulate(scene, [0.0, 0.1, 0.2])
            row[name] = round(time.process_time() - begin, 2)
        row["steps"] = int(run.stats.n_steps)
        row["ratio"] = round(float(np.linalg.norm(run.eccentricity("bearing")[-1])) / 1e-4, 4)
        row["pressure_MPa"] = round(float(run.part("bearing", "film_pressure")[-1]) / 1e6, 3)
        rows.append(row)
        print(*row.values(), flush=True)
    write("lined_bearing_cost", COMMAND, rows)


if __name__ == "__main__":
    costs()
    beside_tables()
    beside_grids()
