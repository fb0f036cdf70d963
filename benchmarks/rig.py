"""Tolerances of a suspension on the rig: hardpoints that scatter by half a millimeter, toe and camber over travel.

    python benchmarks/rig.py                    # 10,000 samples with ideal joints, 1,000 with bushes
    python benchmarks/rig.py --only ideal       # or --only rubber

The program that `sj.vehicle.rig_samples` makes: one sample after the other, on one core. Writes `results/rig.csv`:
samples, positions of each, seconds to compile, seconds of a second call, scatter of toe.
"""

import argparse
import csv
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import spherejax as sj

TRAVEL = np.linspace(-0.08, 0.08, 9)
HALF_WIDTH = 5e-4
"""Of each coordinate of each hardpoint [m], uniform."""

MOVED = ("lower_ball", "upper_ball", "tie_rod_inner", "tie_rod_outer", "lower_arm_front", "upper_arm_front")
DRAWN = {name: np.asarray(place) for name, place in sj.vehicle.DOUBLE_WISHBONE.items() if name in MOVED}
RUBBER = sj.laws.MatrixElastomer.cylindrical(
    (0.0, 0.0, 1.0),
    radial_stiffness=8e6,
    axial_stiffness=1e6,
    conical_stiffness=500.0,
    torsional_stiffness=50.0,
    damping=1e-4,
)


def toe_of(shift, bushes):
    """Toe over travel of a corner whose hardpoints are shifted, shape (18,) [m]."""
    places = {name: place + part for (name, place), part in zip(DRAWN.items(), shift.reshape(-1, 3), strict=True)}
    found = sj.vehicle.rig(sj.gallery.double_wishbone(places, bushes=bushes), TRAVEL)
    return found.toe


def measured(name, n, bushes):
    """A row of the table."""
    shifts = jnp.asarray(np.random.default_rng(0).uniform(-HALF_WIDTH, HALF_WIDTH, (n, 3 * len(DRAWN))))
    began = time.perf_counter()
    many = jax.jit(lambda shifts: jax.lax.map(lambda s: toe_of(s, bushes), shifts))
    program = many.lower(shifts).compile()
    compiled = time.perf_counter() - began
    jax.block_until_ready(program(shifts))
    began = time.perf_counter()
    toe = np.asarray(program(shifts))
    seconds = time.perf_counter() - began
    assert np.all(np.isfinite(toe)), "a sample was not found"
    nominal = toe_of(np.zeros(3 * len(DRAWN)), bushes)
    row = {
        "joints": name,
        "samples": n,
        "positions": len(TRAVEL),
        "compile_s": f"{compiled:.1f}",
        "run_s": f"{seconds:.3f}",
        "toe_at_80mm_deg": f"{np.degrees(nominal[-1]):.4f}",
        "deviation_at_80mm_deg": f"{np.degrees(toe[:, -1].std(ddof=1)):.4f}",
    }
    print(row, flush=True)
    return row


def main():
    """Both, or one."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", choices=("ideal", "rubber"))
    parser.add_argument("--samples", type=int)
    asked = parser.parse_args()
    cases = {"ideal": (10_000, None), "rubber": (1_000, sj.Bushing(law=RUBBER))}
    path = Path(__file__).parent / "results" / "rig.csv"
    rows = {row["joints"]: row for row in csv.DictReader(path.open())} if path.exists() else {}
    for name, (n, bushes) in cases.items():
        if asked.only in (None, name):
            rows[name] = measured(name, asked.samples or n, bushes)
            with path.open("w", newline="") as file:
                writer = csv.DictWriter(file, list(rows[name]))
                writer.writeheader()
                writer.writerows(rows.values())


if __name__ == "__main__":
    main()
