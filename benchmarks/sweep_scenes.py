"""The scenes that the benchmarks of sweeps share."""

import os

import numpy as np

import spherejax as sj

N_RUNS, DURATION = 1000, 0.2
CLEARANCES = np.linspace(5e-5, 2e-4, N_RUNS)
N_CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def model_of(clearance):
    return sj.Dry(clearance=clearance, friction=sj.Threlfall())


def dry(clearance):
    """The four-bar with dry friction."""
    return sj.gallery.four_bar(model_of(clearance))


def elastic(stiffness):
    """The four-bar with a bushing: cheap runs."""
    return sj.gallery.four_bar(sj.Bushing(stiffness, 1e-4))


def film(clearance):
    """The lubricated four-bar."""
    return sj.gallery.four_bar(sj.Lubricated(clearance))
