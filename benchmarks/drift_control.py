"""Drift control on the ideal four-bar: violations, energy, time and achieved error over 2 s and over 1,000 s.

    python benchmarks/drift_control.py

The error is that of the rocker's height at the end, against a run with projection at rtol 1e-11; the last row of each
duration holds a run by Baumgarte's feedback at that tolerance against it. Violations, the quaternions' norm and the
energy are the largest at 101 samples. Times are those of a compiled call (jax.jit of simulate) on one core.
A run that fails (without control the mechanism falls apart in the end) has the time that it reached, and no errors.
"""

from machine import median_seconds, use_one_core, write

use_one_core()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import spherejax as sj  # noqa: E402

CONTROLS = {
    "none": sj.solvers.NoDriftControl(),
    "Baumgarte, 5 1/s": sj.solvers.Baumgarte(),
    "Baumgarte, 50 1/s": sj.solvers.Baumgarte(50.0, 50.0),
    "post-stabilization": sj.solvers.PostStabilization(),
    "projection": sj.solvers.Projection(),
}
DURATIONS = (2.0, 1000.0)
TOLERANCES = (1e-6, 1e-8)
TIGHT = 1e-11


def compiled(control):
    """Runs with one drift control by duration [s] and tolerance."""

    @jax.jit
    def run(duration, rtol):
        ts = duration * jnp.linspace(0.0, 1.0, 101)
        return sj.simulate(sj.gallery.four_bar(drift=control), ts, rtol=rtol, atol=rtol * 1e-3)

    return lambda duration, rtol: jax.block_until_ready(run(duration, rtol))


def height(motion) -> float:
    """The rocker's height at the end [m]."""
    return float(motion.position("rocker")[-1, 2])


def measured(name: str, run, duration: float, rtol: float, reference: float) -> dict[str, object]:
    """One row."""
    motion = run(duration, rtol)
    seconds = median_seconds(lambda: run(duration, rtol))
    energy, quaternions = np.asarray(motion.mechanical_energy), np.asarray(motion.state.quaternion)
    return {
        "drift_control": name,
        "duration_s": f"{duration:g}",
        "reached_s": f"{float(motion.t_reached):g}",
        "rtol": f"{rtol:.0e}",
        "position_violation": f"{float(motion.constraint_violation.max()):.1e}",
        "velocity_violation": f"{float(motion.velocity_violation.max()):.1e}",
        "norm_error": f"{np.abs((quaternions**2).sum(-1) - 1).max():.1e}",
        "energy_error_J": f"{np.abs(energy - energy[0]).max():.1e}",
        "error_m": f"{abs(height(motion) - reference):.1e}",
        "seconds": f"{seconds:.5f}",
        "steps": int(motion.stats.n_steps),
        "us_per_step": f"{seconds / int(motion.stats.n_steps) * 1e6:.2f}",
    }


def main() -> None:
    runs = {name: compiled(control) for name, control in CONTROLS.items()}
    rows = []
    for duration in DURATIONS:
        reference = height(runs["projection"](duration, TIGHT))
        for rtol in TOLERANCES:
            for name, run in runs.items():
                rows.append(measured(name, run, duration, rtol, reference))
                print(rows[-1], flush=True)
        rows.append(measured("Baumgarte, 5 1/s", runs["Baumgarte, 5 1/s"], duration, TIGHT, reference))
    write("drift_control", "python benchmarks/drift_control.py", rows)


if __name__ == "__main__":
    main()
