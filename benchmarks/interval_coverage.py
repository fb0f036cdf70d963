"""Do intervals of 95 percent cover the truth in 95 of 100 cases, where errors are correlated?

    python benchmarks/interval_coverage.py      # 200 refits for each correlation, some ten minutes

A ball on a spring and a damper, whose stiffness, damping and first speed are fitted to its position: 400 readings over
4 s, with errors of an AR(1) process, e_i = r e_(i-1) + w_i, of one standard deviation whatever r is. The noise is not
stated. Each refit has errors of its own; its seed is its number. `independent` are the intervals that the same fit
would give if it took its residuals for white, `allowed_for` those that it gives.

The binomial error of a share of 95 percent in 200 cases is 1.5 percent; parameters of one fit are no independent cases.
"""

import time

from machine import use_one_core, write

use_one_core()

from dataclasses import replace  # noqa: E402

import numpy as np  # noqa: E402
from scipy.signal import lfilter  # noqa: E402

import spherejax as sj  # noqa: E402

COMMAND = "python benchmarks/interval_coverage.py"
N_REFITS = 200
CORRELATIONS = (0.0, 0.5, 0.8, 0.9)
TS = np.linspace(0.01, 4.0, 400)
NOISE = 2e-3  # [m]; 2 percent of the first deflection
TRUTH = {"stiffness": 200.0, "damping": 1.5, "speed": 0.2}  # [N/m], [N s/m], [m/s]
MASS, DEFLECTION = 2.0, 0.1  # [kg], [m]


def build(stiffness, damping, speed):
    ball = sj.Body(
        MASS,
        (1e-3,) * 3,
        position=(1.0 + DEFLECTION, 0.0, 0.0),
        velocity=speed * np.array([1.0, 0.0, 0.0]),
        points={"center": (0.0, 0.0, 0.0)},
    )
    spring = sj.SpringDamper(("ground.wall", "ball.center"), stiffness=stiffness, damping=damping, free_length=1.0)
    return sj.Scene(
        {"ball": ball}, {}, forces={"spring": spring}, gravity=(0.0, 0.0, 0.0), ground_points={"wall": (0.0, 0.0, 0.0)}
    )


def errors(correlation, seed):
    """Errors of unit variance; the process has run for long before the first of them."""
    innovations = np.random.default_rng(seed).normal(size=TS.size + 500)
    return np.asarray(lfilter([np.sqrt(1 - correlation**2)], [1.0, -correlation], innovations))[500:]


def coverage(correlation, clean):
    covered = {"independent": np.zeros(3), "allowed_for": np.zeros(3)}
    widths = {"independent": [], "allowed_for": []}
    failed, began = 0, time.process_time()
    truth = np.array(list(TRUTH.values()))
    for seed in range(N_REFITS):
        measured = {"time": TS, "position.ball.x": clean + NOISE * errors(correlation, seed)}
        fitted = sj.fit(build, {"stiffness": 190.0, "damping": 1.3, "speed": 0.25}, measured, progress=False)
        failed += not fitted.succeeded
        known = fitted.knowledge
        freedom = float(fitted.degrees_of_freedom)
        white = replace(known, correlated=None, degrees_of_freedom=freedom)
        for name, one in (("independent", white), ("allowed_for", known)):
            low, high = one.intervals(0.95).T
            covered[name] += (low <= truth) & (truth <= high)
            widths[name].append((high - low) / truth)
    seconds = (time.process_time() - began) / N_REFITS
    for i, parameter in enumerate(TRUTH):
        row = {"correlation": correlation, "parameter": parameter, "refits": N_REFITS, "failed": failed}
        for name in covered:
            row[f"covered_{name}_percent"] = f"{100 * covered[name][i] / N_REFITS:.1f}"
        for name in covered:
            row[f"width_{name}_percent"] = f"{100 * np.median(np.array(widths[name])[:, i]):.3g}"
        row["processor_s_a_fit"] = f"{seconds:.2g}"
        yield row


def main() -> None:
    run = sj.simulate(build(**TRUTH), np.append(0.0, TS), rtol=1e-10)
    clean = np.asarray(run.position("ball"))[1:, 0]
    rows = []
    for correlation in CORRELATIONS:
        rows += coverage(correlation, clean)
        for row in rows[-len(TRUTH) :]:
            print(row, flush=True)
    write("interval_coverage", COMMAND, rows, ("scipy",))


if __name__ == "__main__":
    main()
