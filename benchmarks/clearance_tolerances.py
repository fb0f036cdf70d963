"""What it would give to judge positions by the clearance alone: steps and reached errors, on eight scenes.

    python benchmarks/clearance_tolerances.py            # ten minutes on two free cores

Positions of a scene with clearances are judged as if they were at most `CLEARANCES` clearances (see
`motion/start/tolerances.py`). Here runs with that number, and with 100, 10 and 1, are compared with a run at
`rtol=1e-12`: their steps, and the largest error of the ball's or journal's place at the samples over the clearance. Of
the same steps as a run by the clearance (`rtol_of_same_steps`) is a run with the usual number and a tighter `rtol`, and
beside it stands the error that it reaches.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from machine import write

import spherejax as sj
from spherejax.motion.runs import preparation, simulate
from spherejax.motion.start import tolerances

USUAL = tolerances.CLEARANCES
CLEARANCES = (USUAL, 100.0, 10.0, 1.0)
RTOLS = (1e-6, 1e-8)
REFERENCE = 1e-12
N_SAMPLES = 201
CYLINDER = sj.laws.JohnsonCylinder(0.02)
FRICTION = sj.Threlfall(mu=0.1)


class Case(NamedTuple):
    """A scene, its length [s], the joint that is looked at."""

    scene: Callable[[], sj.Scene]
    t1: float
    joint: str


def four_bar(model, t1: float) -> Case:
    return Case(lambda: sj.gallery.four_bar(model), t1, "coupler_rocker")


def piston(model, t1: float) -> Case:
    return Case(lambda: sj.gallery.piston(model), t1, "pin")


CASES = {
    "piston, dry journal": piston(sj.Dry(5e-4, conformity=CYLINDER), 0.024),
    "piston, dry journal, 0.1 mm": piston(sj.Dry(1e-4, conformity=CYLINDER), 0.024),
    "piston, journal with film": piston(
        sj.Lubricated(5e-5, 0.1, socket_radius=0.02, film=sj.laws.ShortBearing(0.02), conformity=CYLINDER), 0.02
    ),
    "four-bar, dry": four_bar(sj.Dry(1e-4), 0.1),
    "four-bar, friction": four_bar(sj.Dry(1e-4, friction=FRICTION), 0.2),
    "four-bar, friction, 1 um": four_bar(sj.Dry(1e-6, friction=FRICTION), 0.05),
    "four-bar, film": four_bar(sj.Lubricated(1e-4, 0.4), 0.2),
    "four-bar, film, 20 um": four_bar(sj.Lubricated(2e-5, 0.05), 0.2),
}  # fmt: skip


def place(case: Case, rtol: float, clearances: float = USUAL) -> tuple[np.ndarray, int, float]:
    """The place in the gap at the samples over the clearance, the steps, the estimate of its largest error."""
    tolerances.CLEARANCES = clearances
    preparation.scene_tolerances.table.clear()
    simulate._call.table.clear()
    run = sj.simulate(case.scene(), np.linspace(0.0, case.t1, N_SAMPLES), rtol=rtol, throw=True)
    clearance = float(run.clearance(case.joint))
    estimate = np.nan
    if clearances == USUAL and rtol in RTOLS:
        estimate = float(np.linalg.norm(run.error(f"eccentricity.{case.joint}"), axis=1).max()) / clearance
    return np.asarray(run.eccentricity(case.joint)) / clearance, int(run.stats.n_steps), estimate


def main() -> None:
    rows = []
    for label, case in CASES.items():
        reference, *_ = place(case, REFERENCE)

        def error(found: np.ndarray, reference: np.ndarray = reference) -> float:
            return float(np.linalg.norm(found - reference, axis=1).max())

        for rtol in RTOLS:
            usual = None
            ladder = [(tight, *place(case, tight)) for tight in rtol * 10.0 ** (-0.5 * np.arange(1, 5))]
            for clearances in CLEARANCES:
                found, steps, estimate = place(case, rtol, clearances)
                usual = steps if usual is None else usual
                near = min(ladder, key=lambda one: abs(np.log(one[2] / steps)))
                rows.append({
                    "scene": label,
                    "rtol": f"{rtol:.0e}",
                    "clearances": f"{clearances:.0e}",
                    "steps": steps,
                    "share_of_steps": f"{steps / usual:.2f}",
                    "error_over_clearance": f"{error(found):.1e}",
                    "estimate": "" if np.isnan(estimate) else f"{estimate:.1e}",
                    "rtol_of_same_steps": f"{near[0]:.0e}" if steps > 1.1 * usual else "",
                    "its_steps": near[2] if steps > 1.1 * usual else "",
                    "its_error": f"{error(near[1]):.1e}" if steps > 1.1 * usual else "",
                })  # fmt: skip
                print(*rows[-1].values(), flush=True)
    tolerances.CLEARANCES = USUAL
    write("clearance_tolerances", "python benchmarks/clearance_tolerances.py", rows)


if __name__ == "__main__":
    main()
