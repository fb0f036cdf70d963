"""The same mechanisms in Exudyn and MuJoCo: do they move alike, and what does it take?

    python benchmarks/cross_checks.py                  # about 4 minutes
    python benchmarks/cross_checks.py four_bar chain   # some cases

Scenes are translated element by element from the `Scene` (`peers/`), forces of the suspension written anew. Both peers
take fixed steps; each halving shows their order, and how their motion tends to ours. The difference is the largest of
all centers of mass at 51 samples. spherejax runs at rtol 1e-10; its own error is that against 1e-12.
Needs `pip install exudyn mujoco`; a package that is not installed is left out, and the run says so.
"""

import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from machine import write
from peers import exudyn_scene, mujoco_scene, suspension_forces
from peers.started import NoCounterpartError

import spherejax as sj


class Case(NamedTuple):
    """A scene, its duration [s], the peers' largest step [s], and what adds its forces to Exudyn."""

    build: Callable[[], sj.Scene]
    duration: float
    step: float
    add_forces: Callable | None = None


def elastic_four_bar() -> sj.Scene:
    return sj.gallery.four_bar(sj.Bushing(law=sj.laws.VectorElastomer(1e5, 1e-3)))


CASES = {
    "four_bar": Case(sj.gallery.four_bar, 1.0, 1e-3),
    "four_bar_bushing": Case(elastic_four_bar, 0.5, 2e-4),
    "chain": Case(lambda: sj.gallery.chain(4), 1.0, 1e-3),
    "n_four_bar": Case(lambda: sj.gallery.n_four_bar(2), 1.0, 1e-3),
    "slider_crank": Case(sj.gallery.slider_crank, 0.5, 5e-4),
    "governor": Case(sj.gallery.governor, 1.0, 1e-3),
    "suspension": Case(lambda: sj.gallery.suspension(link_mass=0.5), 4.0, 2e-3, suspension_forces.add),
}

PEERS = {"Exudyn": exudyn_scene, "MuJoCo": mujoco_scene}
HALVINGS = 3
N_SAMPLES = 51


def ours(scene: sj.Scene, ts, rtol: float) -> tuple[dict[str, np.ndarray], float]:
    """Positions of the bodies, and seconds of a warm run."""

    def run():
        return jax.block_until_ready(sj.simulate(scene, ts, rtol=rtol, throw=True).ys)

    run()
    begin = time.perf_counter()
    run()
    seconds = time.perf_counter() - begin
    motion = sj.simulate(scene, ts, rtol=rtol)
    return {name: np.asarray(motion.position(name)) for name in motion.system.bodies}, seconds


def largest_difference(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> float:
    return max(float(np.abs(a[name] - b[name]).max()) for name in a)


def rows_of(name: str, case: Case) -> list[dict]:
    scene, ts = case.build(), np.linspace(0.0, case.duration, N_SAMPLES)
    reference, _ = ours(scene, ts, 1e-12)
    own, seconds = ours(scene, ts, 1e-10)
    rows = [_row(name, "spherejax", "rtol 1e-10", largest_difference(own, reference), seconds)]
    for peer, translator in PEERS.items():
        given = {"add_forces": case.add_forces} if peer == "Exudyn" and case.add_forces else {}
        try:
            run = translator.runner(scene, **given)
            for halving in range(HALVINGS):
                step = case.step / 2**halving
                begin = time.perf_counter()
                positions = run(step, ts)
                taken = time.perf_counter() - begin
                rows.append(_row(name, peer, f"step {step:.3g} s", largest_difference(positions, reference), taken))
        except (ImportError, NoCounterpartError) as reason:
            rows.append(_row(name, peer, f"left out: {reason}", None, None))
    return rows


def _row(name, who, how, difference, seconds) -> dict:
    return {
        "case": name,
        "simulator": who,
        "how": how,
        "largest_difference_m": "" if difference is None else f"{difference:.1e}",
        "seconds": "" if seconds is None else f"{seconds:.3g}",
    }


def main() -> None:
    rows = [row for name in sys.argv[1:] or CASES for row in rows_of(name, CASES[name])]
    write("cross_checks", "python benchmarks/cross_checks.py", rows, ("exudyn", "mujoco"))


if __name__ == "__main__":
    main()
