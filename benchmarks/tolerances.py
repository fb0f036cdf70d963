"""What studies of tolerances cost, on all cores.

    python benchmarks/tolerances.py            # two minutes

The four-bar for 0.2 s with every joint ideal (10,000 samples) and with a bushing (1,000), numbers drawn within
tolerances, against the budget of first order with its check. Medians of five, without compilation.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from machine import median_seconds, write

import spherejax as sj

TS = jnp.linspace(0.0, 0.2, 21)
MASS = {"rocker": sj.studies.Tolerance(0.0316, 5e-4), "coupler": sj.studies.Tolerance(0.1416, 2e-3)}
RUBBER = {"stiffness": sj.studies.Tolerance(1e5, 2e4), "damping": sj.studies.Tolerance(1e-3, 3e-4)}


def with_masses(scene, rocker, coupler):
    return eqx.tree_at(lambda s: (s.bodies["rocker"].mass, s.bodies["coupler"].mass), scene, (rocker, coupler))


def ideal(rocker, coupler):
    return with_masses(sj.gallery.four_bar(sj.Ideal()), rocker, coupler)


def rubber(rocker, coupler, stiffness, damping):
    return with_masses(sj.gallery.four_bar(sj.Bushing(stiffness, damping)), rocker, coupler)


def studied(joints, build, spreads, n):
    """Seconds of both studies, and the standard deviations of the rocker's height at the end that they find."""

    def samples():
        return sj.monte_carlo(build, spreads, TS, record=["final position.rocker"], n=n, progress=False)

    def first_order():
        return sj.studies.tolerance_budget(build, spreads, TS, observables=["position.rocker.z"])

    drawn, part = samples(), first_order().of("position.rocker.z")
    assert np.all(drawn.is_used)
    return {
        "joints": joints,
        "samples": n,
        "monte_carlo_s": f"{median_seconds(samples):.3f}",
        "budget_s": f"{median_seconds(first_order):.3f}",
        "deviation_by_samples_m": f"{float(drawn.deviation['final_position.rocker'].sel(axis='z')):.4g}",
        "deviation_by_budget_m": f"{part.deviation[-1, 0]:.4g}",
        "first_order_is_off_by": f"{part.bent:.2g}",
    }


def main() -> None:
    """Both, to `results/tolerances.csv`."""
    rows = [studied("ideal", ideal, MASS, 10_000), studied("bushing", rubber, {**MASS, **RUBBER}, 1_000)]
    write("tolerances", "python benchmarks/tolerances.py", rows)


if __name__ == "__main__":
    main()
