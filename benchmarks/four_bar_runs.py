"""Whole runs of the four-bar: scalar program against array code, and every model at several tolerances.

    python benchmarks/four_bar_runs.py

The error is that of the rocker's height at the end, against a run of the same equations at rtol 1e-13
(stiff bushing: 1e-11; film: 1e-10).
Times are those of a compiled call (jax.jit of simulate) on one core.
"""

from machine import median_seconds, use_one_core, write

use_one_core()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

import spherejax as sj  # noqa: E402

PAPERS_FILM = sj.Lubricated(1e-4, film=sj.laws.RadialFilm(), normal=sj.LankaraniNikravesh(0.9))
"""With the paper's contact as well: the hand-written equations have no other."""

CASES = {
    "ideal, 2 s": (sj.Ideal(), 2.0, 1e-13),
    "bushing k 1e6 b 1e-4, 2 s": (sj.Bushing(1e6, 1e-4), 2.0, 1e-13),
    "bushing k 1e6 b 1e-2, 2 s": (sj.Bushing(1e6, 1e-2), 2.0, 1e-11),
    "dry with friction, 0.2 s": (sj.Dry(1e-4, friction=sj.Threlfall()), 0.2, 1e-13),
    "dry with friction, 2 s": (sj.Dry(1e-4, friction=sj.Threlfall()), 2.0, 1e-13),
    "lubricated c 0.10 mm, 2 s": (sj.Lubricated(1e-4), 2.0, 1e-11),
    "paper's film c 0.10 mm, 2 s": (PAPERS_FILM, 2.0, 1e-10),
}


def compiled(model, duration: float, rtol: float, scalar: bool = True):
    """A compiled run from nothing to the final height of the rocker [m] and the number of steps."""
    ts = jnp.array([0.0, duration])

    @jax.jit
    def run(tolerance):
        motion = sj.simulate(sj.gallery.four_bar(model), ts, rtol=tolerance, atol=tolerance * 1e-3, scalar=scalar)
        return motion.position("rocker")[-1, 2], motion.stats.n_steps

    return lambda: jax.block_until_ready(run(rtol))


def main() -> None:
    rows = []
    for name, (model, duration, tight) in CASES.items():
        reference = float(compiled(model, duration, tight)()[0])
        for rtol in (1e-6, 1e-8, 1e-10):
            if rtol <= tight:
                continue
            call = compiled(model, duration, rtol)
            height, n_steps = call()
            row = {
                "case": name,
                "rtol": f"{rtol:.0e}",
                "milliseconds": f"{median_seconds(call) * 1e3:.2f}",
                "steps": int(n_steps),
                "error_m": f"{abs(float(height) - reference):.1e}",
                "array_milliseconds": "",
                "ratio_array_to_scalar": "",
            }
            if rtol == 1e-8 and not isinstance(model, sj.Lubricated) and duration * tight < 1e-11:
                array = compiled(model, duration, rtol, scalar=False)
                seconds = median_seconds(array, 3)
                row["array_milliseconds"] = f"{seconds * 1e3:.1f}"
                row["ratio_array_to_scalar"] = f"{seconds * 1e3 / float(row['milliseconds']):.1f}"
            rows.append(row)
            print(row, flush=True)
    write("four_bar_runs", "python benchmarks/four_bar_runs.py", rows)


if __name__ == "__main__":
    main()
