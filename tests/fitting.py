"""The four-bar with a bushing, measured: the example of the tests of `sj.fit`."""

import numpy as np

import spherejax as sj

STIFFNESS, DAMPING = 1e5, 1e-3  # [N/m], [s]
NOISE = 1e-6  # [m]
TS = np.linspace(1e-3, 0.5, 500)  # [s]


def bushing_four_bar(stiffness, damping):
    return sj.gallery.four_bar(sj.Bushing(stiffness, damping))


def rocker_motion(stiffness=STIFFNESS, damping=DAMPING, ts=TS) -> np.ndarray:
    """The rocker's z without noise [m]."""
    run = sj.simulate(bushing_four_bar(stiffness, damping), np.concatenate([[0.0], ts]), rtol=1e-10)
    return np.asarray(run.position("rocker"))[1:, 2]


def measured(motion, noise=NOISE, seed=0, ts=TS) -> dict:
    """What a sensor with white noise would have said."""
    return {"time": ts, "position.rocker.z": motion + noise * np.random.default_rng(seed).normal(size=ts.size)}
