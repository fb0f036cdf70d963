"""What methods of diffrax cost on a mechanism, at the same achieved error.

    python benchmarks/diffrax_methods.py            # three minutes

Each method runs the four-bar at tolerances from 1e-4 on until its error in the rocker's place is at most `WANTED`,
against a reference at 1e-11 by the method that the scene calls for. Medians of five runs, after one to compile, in
shares of the time of `solver=None` at its own tolerance for that error.
"""

import warnings

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from machine import median_seconds, write

import spherejax as sj

TS = jnp.linspace(0.0, 0.1, 51)
WANTED = 1e-9
TOLERANCES = [10.0**-n for n in range(4, 12)]
JOINTS = {
    "ideal": sj.Ideal(),
    "dry with friction": sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=0.1, v1=1e-3)),
    "bushing": sj.Bushing(stiffness=1e6, damping=1e2),
    "lubricated": sj.Lubricated(clearance=1e-4, viscosity=0.4),
}
SOLVERS = {
    "as chosen": None,
    "Dopri8": diffrax.Dopri8(),
    "Tsit5": diffrax.Tsit5(),
    "Rodas5P": sj.solvers.Rodas5P(),
    "Kvaerno3": diffrax.Kvaerno3(),
    "Kvaerno5": diffrax.Kvaerno5(),
}
MAX_STEPS = 50_000


def cheapest(scene, solver, reference):
    """The row of the loosest tolerance that gives the wanted error; None where none does within the steps allowed."""
    for rtol in TOLERANCES:

        def run(rtol=rtol):
            return sj.simulate(scene, TS, rtol=rtol, solver=solver, max_steps=MAX_STEPS)

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", sj.SimulationWarning)  # too many steps: a row says so
            found = run()
        if not bool(found.succeeded):
            continue
        error = float(np.abs(found.position("rocker") - reference).max())
        if error <= WANTED:
            seconds = median_seconds(lambda run=run: jax.block_until_ready(run().ys))
            return {
                "rtol": f"{rtol:.0e}",
                "steps": int(found.stats.n_steps),
                "seconds": seconds,
                "error": f"{error:.1e}",
            }
    return None


def main() -> None:
    """All joints and methods, to `results/diffrax_methods.csv`."""
    rows = []
    for joint, model in JOINTS.items():
        scene = sj.gallery.four_bar(model)
        reference = sj.simulate(scene, TS, rtol=1e-11).position("rocker")
        usual = 1.0
        for name, solver in SOLVERS.items():
            row = cheapest(scene, solver, reference)
            if row is None:
                rows.append({"joint": joint, "solver": name, "rtol": "none", "steps": f"> {MAX_STEPS}"})
                continue
            seconds = row.pop("seconds")
            usual = seconds if solver is None else usual
            times = {"milliseconds": f"{1e3 * seconds:.2f}", "time_of_as_chosen": f"{seconds / usual:.2f}"}
            rows.append({"joint": joint, "solver": name, **row, **times})
            print(rows[-1], flush=True)
    write("diffrax_methods", "python benchmarks/diffrax_methods.py", rows)


if __name__ == "__main__":
    main()
