"""The lubricated four-bar with the paper's film and with the full one, beside the ideal joint: motion, steps, time.

    python benchmarks/full_film.py            # five minutes, of which compiling is most

2 s at an rtol of 1e-8, 0.4 Pa s. `peak` is the largest vertical acceleration of the rocker over 2,001 samples.
"""

import time

from machine import use_one_core, write

use_one_core()

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import spherejax as sj  # noqa: E402

TURNS, RTOL = 5, 1e-8
TIMES = jnp.linspace(0.0, 2.0, 2001)
JOINT = "coupler_rocker"


def film(clearance: float, kind: sj.laws.AbstractFilm) -> sj.Lubricated:
    return sj.Lubricated(clearance=clearance, viscosity=0.4, film=kind)


CASES = {
    "ideal": (sj.Ideal(), None),
    "paper's film, c 0.10 mm": (film(1e-4, sj.laws.RadialFilm()), 1e-4),
    "full film, c 0.05 mm": (film(5e-5, sj.laws.FullFilm()), 5e-5),
    "full film, c 0.10 mm": (film(1e-4, sj.laws.FullFilm()), 1e-4),
    "full film, c 0.20 mm": (film(2e-4, sj.laws.FullFilm()), 2e-4),
}


def main() -> None:
    rows = []
    for name, (model, clearance) in CASES.items():
        scene = sj.gallery.four_bar(model)
        run = sj.simulate(scene, TIMES, rtol=RTOL)
        seconds = []
        for _ in range(TURNS):
            begin = time.perf_counter()
            sj.simulate(scene, jnp.array([0.0, 2.0]), rtol=RTOL).ys.block_until_ready()
            seconds.append(time.perf_counter() - begin)
        row = {
            "case": name,
            "status": run.status.name,
            "steps": int(run.stats.n_accepted),
            "milliseconds": f"{1e3 * np.median(seconds[1:]):.1f}",
            "peak_m_per_s2": f"{np.abs(np.asarray(run.acceleration('rocker'))[:, 2]).max():.2f}",
            **dict.fromkeys(("largest_ratio", "film_power_mJ", "shear_power_mJ"), ""),
        }
        if clearance is not None:
            ratio = np.linalg.norm(np.asarray(run.eccentricity(JOINT)), axis=1).max() / clearance
            power = {kind: np.asarray(run.part(JOINT, kind)) for kind in ("film_power", "shear_power")}
            row["largest_ratio"] = f"{ratio:.3f}"
            row |= {f"{kind}_mJ": f"{1e3 * np.trapezoid(each, TIMES):.2f}" for kind, each in power.items()}
        rows.append(row)
        print(row, flush=True)
    write("full_film", "python benchmarks/full_film.py", rows)


if __name__ == "__main__":
    main()
