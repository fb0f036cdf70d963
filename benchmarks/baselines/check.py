"""The hand-written equations against spherejax's: the largest difference, and microseconds a call.

python -m baselines.check      (from the folder benchmarks)
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
from numba import njit

import spherejax as sj
from baselines import parameters as at
from baselines.equations import rate_function
from baselines.parameters import N_STATE, problem
from spherejax.model.system import compile_scene
from spherejax.motion.equations.dynamics import state_rate

MODELS = {
    "ideal": sj.Ideal(),
    "bushing": sj.Bushing(1e6, 1e-4),
    "dry": sj.Dry(1e-4),
    "dry with friction": sj.Dry(1e-4, friction=sj.Threlfall()),
    "lubricated": sj.Lubricated(
        1e-4, friction=sj.Threlfall(), film=sj.laws.RadialFilm(), normal=sj.LankaraniNikravesh(0.9)
    ),
}
LARGEST_DIFFERENCE = 1e-12


def largest_difference(model, n_states: int = 60, seed: int = 0) -> float:
    """Largest relative difference of the two right-hand sides over random states near the start.

    Eccentricities reach a few times the clearance; half of the states are in contact mode. Each
    block of accelerations is compared relative to its largest entry.
    """
    kind, p, y0 = problem(model)
    system = compile_scene(sj.gallery.four_bar(model)).system
    rate, out = rate_function(kind), np.zeros(N_STATE)
    theirs = jax.jit(lambda y: state_rate(system, 0.0, y))
    rng = np.random.default_rng(seed)
    worst = 0.0
    for i in range(n_states):
        y = y0.copy()
        y[:21] += rng.normal(size=21) * 3e-4 * rng.uniform(0.2, 1.0)
        for start in (3, 10, 17):
            # spherejax takes a quaternion for that of unit norm, the hand-written equations take it as it is.
            y[start : start + 4] /= np.linalg.norm(y[start : start + 4])
        y[21:] += rng.normal(size=18) * np.tile([0.05, 0.05, 0.05, 1.0, 1.0, 1.0], 3)
        onset_rate = 0.01 * (i % 2)
        rate(y, onset_rate, p, out)
        memory = [onset_rate] * system.layout.n_memory
        expected = np.array(theirs(jnp.array([*y, *memory])))[:N_STATE]
        for block in (slice(0, 21), slice(21, 39)):
            scale = np.abs(expected[block]).max()
            worst = max(worst, np.abs(out[block] - expected[block]).max() / scale)
    return worst


def microseconds(model, n_calls: int = 300_000) -> float:
    """Time of one call in a compiled loop whose calls depend on each other [us], the least of three."""
    kind, p, y0 = problem(model)
    rate = rate_function(kind)

    @njit
    def loop(y, p, out, n):
        for _ in range(n):
            rate(y, 0.01, p, out)
            for i in range(N_STATE):
                y[i] += 1e-12 * out[i]

    y, out = y0.copy(), np.zeros(N_STATE)
    y[14] += 1.1 * p[at.CLEARANCE]
    loop(y, p, out, 10)
    seconds = []
    for _ in range(3):
        begin = time.perf_counter()
        loop(y, p, out, n_calls)
        seconds.append(time.perf_counter() - begin)
    return min(seconds) / n_calls * 1e6


def main() -> None:
    for name, model in MODELS.items():
        difference = largest_difference(model)
        print(f"{name:15s} {microseconds(model):.3f} us a call, difference {difference:.1e}", flush=True)
        assert difference < LARGEST_DIFFERENCE, name


if __name__ == "__main__":
    main()
