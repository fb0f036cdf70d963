"""What a first call costs: imports, tracing and compiling, and the same in a new process that finds what was kept.

    python benchmarks/start_up.py                    # five minutes, of which the film and the gradients are most
    python benchmarks/start_up.py --only dry ideal

Processor time, for compilers use several cores and machines are busy. The unit U is the processor time of the first
`diffeqsolve` of the Lorenz system with Dopri8, in a process without caches: so much is asked of the machine by diffrax
alone. The scene is the four-bar, 0.2 s, 21 samples; a first call is all from the imports to the sampled states. "Kept"
is the first call of a process that finds in its cache folder what another one has left.
"""

import argparse
import os
import subprocess
import sys
import tempfile

import numpy as np
from machine import write

LORENZ = """
import time, jax
jax.config.update("jax_enable_x64", True)
import diffrax, jax.numpy as jnp
begin = time.process_time()
def rate(t, y, args):
    return jnp.stack([10 * (y[1] - y[0]), y[0] * (28 - y[2]) - y[1], y[0] * y[1] - 8 / 3 * y[2]])
jax.block_until_ready(diffrax.diffeqsolve(
    diffrax.ODETerm(rate), diffrax.Dopri8(), 0.0, 1.0, None, jnp.array([1.0, 2.0, 3.0]),
    stepsize_controller=diffrax.PIDController(rtol=1e-8, atol=1e-8), saveat=diffrax.SaveAt(ts=jnp.linspace(0, 1, 21)),
).ys)
print(time.process_time() - begin)
"""

CALL = """
import time
import jax, jax.numpy as jnp
import spherejax as sj
ts = jnp.linspace(0.0, 0.2, 21)
def ys(joint):
    return sj.simulate(sj.gallery.four_bar(joint), ts, {options}).ys
all_names = [getattr(sj, name) for name in sj.__all__]  # each loads its module: an import, and not the call
begin = time.process_time()
jax.block_until_ready({call})
print(time.process_time() - begin)
"""

DRY, BUSHING, FILM = (
    "sj.Dry({}, friction=sj.Threlfall())",
    "sj.Bushing({}, 1e-4)",
    "sj.Lubricated({}, viscosity=0.1)",
)


def plain(joint: str) -> str:
    return CALL.format(call=f"ys({joint})", options="")


def traced(joint: str, number: str, how: str) -> str:
    """The call as a function of a number, under a transformation."""
    return CALL.format(call=how.format(f"lambda x: ys({joint.format('x')})[-1, 2]") + f"({number})", options="")


CALLS = {
    "ideal": ("four-bar ideal", plain("sj.Ideal()"), 3.0),
    "dry": ("four-bar dry with friction", plain(DRY.format("1e-4")), 3.0),
    "bushing": ("four-bar bushing", plain(BUSHING.format("1e6")), 3.0),
    "film": ("four-bar lubricated", plain(FILM.format("1e-4")), 6.0),
    "dry-jit": ("dry, traced by jit", traced(DRY, "1e-4", "jax.jit({})"), 1.2),
    "dry-grad": ("dry, gradient", traced(DRY, "1e-4", "jax.jit(jax.grad({}))"), 8.0),
    "film-grad": ("lubricated, gradient", traced(FILM, "1e-4", "jax.jit(jax.grad({}))"), 8.0),
    "dry-plain-grad": ("dry, gradient outside jit", traced(DRY, "1e-4", "jax.grad({})"), None),
    "dry-vmap": ("dry, vmap of 128", traced(DRY, "jnp.linspace(8e-5, 1.2e-4, 128)", "jax.vmap({})"), None),
    "film-vmap": ("lubricated, vmap of 128", traced(FILM, "jnp.linspace(8e-5, 1.2e-4, 128)", "jax.vmap({})"), None),
}
OF_THE_PLAIN_CALL = "dry-jit"
"""Whose goal is in units of the plain call."""


IMPORTS = {
    "import spherejax": "import spherejax",
    "import spherejax, and each of its names": "import spherejax as sj; [getattr(sj, name) for name in sj.__all__]",
    "import diffrax, matplotlib.figure": "import diffrax, matplotlib.figure",
}
REPEATS = 3


def printed(code: str, cache: str) -> float:
    """The number that a process prints last, with a folder of caches or none ("0")."""
    return numbers_printed(code, cache)[-1]


def numbers_printed(code: str, cache: str, n: int = 1) -> list[float]:
    """The last numbers that a process prints."""
    environment = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    environment["SPHEREJAX_CACHE"] = cache
    done = subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True)
    return [float(word) for word in done.stdout.split()[-n:]]


def of_command(words: list[str]) -> float:
    """Processor time of a process [s], the median of some."""
    found = []
    for _ in range(REPEATS):
        before = os.times()
        subprocess.run(words, capture_output=True, check=False)
        after = os.times()
        found.append(after.children_user + after.children_system - before.children_user - before.children_system)
    return float(np.median(found))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=CALLS, default=list(CALLS))
    chosen = parser.parse_args().only
    unit = float(np.median([printed(LORENZ, "0") for _ in range(REPEATS)]))
    rows = [row("U: the Lorenz system by diffrax", unit, unit, 1.0)]
    plain_seconds = 0.0
    for name in chosen:
        what, code, goal = CALLS[name]
        with tempfile.TemporaryDirectory() as cache:
            first = printed(code, cache)
            again = float(np.median([printed(code, cache) for _ in range(REPEATS)]))
        if name == "dry":
            plain_seconds = first
        goal = goal and goal * plain_seconds / unit if name == OF_THE_PLAIN_CALL else goal
        rows += [row(what, first, unit, goal), row(f"{what}, kept", again, unit, 0.5 / unit)]
    seconds = {what: of_command([sys.executable, "-c", code]) for what, code in IMPORTS.items()}
    *_, others = seconds
    rows += [
        row(what, each, unit, None if what == others else 1.1 * seconds[others] / unit)
        for what, each in seconds.items()
    ]
    command = os.path.join(os.path.dirname(sys.executable), "spherejax")
    rows.append(row("spherejax --help", of_command([command, "--help"]), unit, 0.5 / unit))
    rows.append(row("spherejax run nothing", of_command([command, "run", "nothing"]), unit, 0.5 / unit))
    only = "" if chosen == list(CALLS) else f" --only {' '.join(chosen)}"
    write("start_up", f"python benchmarks/start_up.py{only}", rows)


def row(what: str, seconds: float, unit: float, goal: float | None) -> dict[str, object]:
    """One line of the table."""
    return {
        "what": what,
        "processor_s": f"{seconds:.2f}",
        "U": f"{seconds / unit:.1f}",
        "goal_U": "" if goal is None else f"{goal:.1f}",
    }


if __name__ == "__main__":
    main()
