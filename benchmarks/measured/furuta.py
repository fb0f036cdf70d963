"""Furuta pendulum: friction of both joints from one record of 40 s, in which the arm comes to rest and stays.

The mechanism is the published one, with the numbers that the Modelica library gives where the model leaves them open:
the arm's center of mass lies on its axis, and moments of inertia that are not stated are 0.001 kg m^2. y points up; the
arm turns about y, the pendulum about the arm's own x axis, and its angle is 0 upright.

No body has the pendulum's published moments, 0.00384, 0.001 and 0.001 kg m^2: the first is larger than the sum of the
others, and spherejax refuses them. The motion depends on the difference of the last two, and on their sum with the
arm's moment about y; so 0.00095 kg m^2 stand on the pendulum instead of the arm, and the motion is the published one.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import spherejax as sj
from measured.arms import bearing
from measured.comparing import (
    BLUE,
    GRAY,
    ORANGE,
    Part,
    Search,
    effort_row,
    fitted,
    least_squares_by_differences,
    nelder_mead,
    number_rows,
    predicted,
    root_mean_squares,
)
from measured.records import read

ARM, LENGTH = 0.245, 0.421
"""Length of the arm and of the pendulum, whose center of mass is in its middle [m]."""

ARM_INERTIA, PENDULUM_INERTIA, HANGING_INERTIA = 0.00005, 0.00384, 0.00195
"""Moments of inertia about the centers [kg m^2]: arm about y; pendulum about its joint's axis, and about others."""

RADIUS = 0.005
"""Of both journals [m]. The record determines products of a radius and a friction coefficient, not the factors."""

RATE, COARSE_RATE = 2e-4, 1e-3
"""Angular speeds at which three quarters of a dry moment act [rad/s]. The smaller one is near Coulomb's law; the larger
one makes runs four times as short, for comparisons of methods and of models."""

PUBLISHED = {"arm_moment": 0.009972, "pendulum_moment": 0.000994}
PUBLISHED_COST = 1.09944
FIRST_GUESS = {"arm_moment": 0.012, "pendulum_moment": 0.002}
"""Numbers of the published model's file, where its search began [N m]."""

UNITS = {
    "arm_moment": "N m", "pendulum_moment": "N m", "arm_start": "rad", "pendulum_start": "rad", "friction": "1",
    "arm_viscous": "N m s/rad", "pendulum_viscous": "N m s/rad", "arm_inertia": "kg m^2", "pendulum_inertia": "kg m^2",
}  # fmt: skip
HALF = 20.0
"""End of the part of the record that models are fitted to, when they are compared by what they predict [s]."""

NOISE = {"arm": 0.030, "pendulum": 0.0197}
"""Scatter of both angles about smooth curves [rad]: polynomials of degree 4 through 9 samples."""


def furuta(
    arm_moment,
    pendulum_moment,
    friction=None,
    *,
    arm_viscous=0.0,
    pendulum_viscous=0.0,
    arm_inertia=ARM_INERTIA,
    pendulum_inertia=PENDULUM_INERTIA,
    arm_start=0.0,
    pendulum_start=np.pi / 6,
    breakaway=None,
    rate=RATE,
):
    """The mechanism, released from rest at two angles [rad]."""
    hinges = [
        bearing(moment, mu, breakaway, radius=RADIUS, rate=rate)
        for moment, mu in ((arm_moment, None), (pendulum_moment, friction))
    ]
    c, s = jnp.cos(arm_start), jnp.sin(arm_start)
    along, up = jnp.stack([c, 0.0 * c, -s]), jnp.array([0.0, 1.0, 0.0])
    across = jnp.stack([s, 0.0 * c, c])
    pivot = ARM * along
    center = pivot + LENGTH / 2 * (jnp.cos(pendulum_start) * up + jnp.sin(pendulum_start) * across)
    half = jnp.stack([arm_start, pendulum_start]) / 2
    (ca, cp), (sa, sp) = jnp.cos(half), jnp.sin(half)
    bodies = {
        "arm": sj.Body(
            0.165,
            (arm_inertia / 2, arm_inertia, arm_inertia / 2),
            (0.0, 0.0, 0.0),
            quaternion=jnp.stack([ca, 0.0 * ca, sa, 0.0 * ca]),
        ),
        "pendulum": sj.Body(
            0.035,
            (pendulum_inertia, HANGING_INERTIA, HANGING_INERTIA),
            center,
            quaternion=jnp.stack([ca * cp, ca * sp, sa * cp, -sa * sp]),
        ),
    }
    joints = {
        "arm_joint": sj.Revolute(("ground", "arm"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), hinges[0]),
        "pendulum_joint": sj.Revolute(("arm", "pendulum"), pivot, along, hinges[1]),
    }
    drags = {
        "arm_drag": sj.TorsionalSpring(("ground", "arm"), (0.0, 1.0, 0.0), damping=arm_viscous),
        "pendulum_drag": sj.TorsionalSpring(("arm", "pendulum"), along, damping=pendulum_viscous),
    }
    return sj.Scene(bodies, joints, drags, gravity=(0.0, -9.81, 0.0))


def arm_angle(run):
    """Angle of the arm [rad]."""
    w, _, y, _ = run.quaternion("arm")[0]
    return run.force("arm_drag")["angle"] + 2 * jnp.arctan2(y, w)


def pendulum_angle(run):
    """Angle of the pendulum from upright [rad]."""
    w, x, _, _ = run.quaternion("pendulum")[0]
    return run.force("pendulum_drag")["angle"] + 2 * jnp.arctan2(x, w)


FUNCTIONS = {"arm": arm_angle, "pendulum": pendulum_angle}


def two_moments(arm_moment, pendulum_moment, rate=RATE):
    """The published model: two dry moments."""
    return furuta(arm_moment, pendulum_moment, rate=rate)


def with_stribeck(rate=0.05, **numbers):
    """Dry moments that are larger than those of fast turning by a share `breakaway`, the most at `rate` [rad/s]."""
    return furuta(rate=rate, **numbers)


def coarsely(build):
    """A mechanism whose dry moments begin at `COARSE_RATE`."""
    return build if build is with_stribeck else partial(build, rate=COARSE_RATE)


START = {
    "arm_start": sj.Parameter(0.001, scale=0.02),
    "pendulum_start": sj.Parameter(np.pi / 6, scale=0.02),
}
MODELS = {
    "two moments": (two_moments, {}),
    "and start, inertia": (furuta, {**START, "pendulum_inertia": PENDULUM_INERTIA}),
    "and start, friction by reaction": (furuta, {**START, "friction": 0.02}),
    "and start, Stribeck": (with_stribeck, {**START, "breakaway": 0.1, "rate": 0.05}),
}
"""By name: the mechanism and its parameters beside the two moments."""


def study(folder: Path) -> Iterator[Part]:
    """The published model, refitted; and whether more friction predicts better."""
    record = read(folder, "furuta.csv")
    ts, angles = record.times, record.values
    everything = measured_of(ts, angles, 0.026)
    _, search = fitted(coarsely(two_moments), FIRST_GUESS, everything, rtol=1e-7)
    fit, fine = fitted(two_moments, search.numbers, everything, rtol=1e-7)
    yield "numbers", number_rows("two moments", fit, UNITS, PUBLISHED)
    published = predicted(two_moments(**PUBLISHED), ts, FUNCTIONS, rtol=1e-7)
    own = predicted(two_moments(**fit.estimates), ts, FUNCTIONS, rtol=1e-7)
    yield "figure", _figure(ts, angles, published, own)
    simplex = nelder_mead(coarsely(two_moments), FIRST_GUESS, ts, angles, FUNCTIONS, rtol=1e-7)
    by_differences = {
        kind: least_squares_by_differences(
            coarsely(two_moments), FIRST_GUESS, ts, angles, FUNCTIONS, rtol=1e-7, diff_step=step
        )
        for kind, step in (("its own differences", None), ("differences of 0.1 %", 1e-3))
    }
    here = Search(PUBLISHED, float(np.sum((published - angles) ** 2)), 1, 0.0)
    by_others = dict.fromkeys(effort_row("", here), "")
    by_others |= {"method": "published (Nelder-Mead in JModelica)", "parameters": 2, "sum_of_squares": PUBLISHED_COST}
    yield (
        "effort",
        [
            by_others,
            effort_row("the published numbers, simulated here", here),
            effort_row("sj.fit, coarse (runs with derivatives)", search),
            effort_row("SciPy's Nelder-Mead, coarse, from the same start", simplex),
            *(effort_row(f"SciPy's least_squares, coarse, {kind}", search) for kind, search in by_differences.items()),
            effort_row("sj.fit, from the coarse result", fine),
        ],
    )
    yield "predictions", [_held_out(name, ts, angles, search.numbers) for name in MODELS]


def measured_of(ts, angles, noise, until=np.inf) -> sj.Measured:
    """The record up to an instant; later samples count as missing, so that the program of the fit is the same."""
    values = np.where((ts <= until)[:, None], angles, np.nan)
    return sj.Measured(ts, dict(zip(FUNCTIONS, values.T, strict=True)), functions=FUNCTIONS, noise=noise)


def _held_out(name: str, ts, angles, moments) -> dict[str, object]:
    """A model fitted to the first half of the record, and its errors in the second."""
    build, more = MODELS[name]
    half = measured_of(ts, angles, NOISE, until=HALF)
    method = sj.studies.LevenbergMarquardt(max_iterations=10, tolerance=0.1)
    fit, search = fitted(coarsely(build), {**moments, **more}, half, rtol=1e-7, method=method)
    errors = predicted(coarsely(build)(**fit.estimates), ts, FUNCTIONS, rtol=1e-7) - angles
    begin = {key: _begun_at(value, fit.estimates[key]) for key, value in {**moments, **more}.items()}
    _, whole = fitted(coarsely(build), begin, measured_of(ts, angles, NOISE), rtol=1e-7, method=method)
    seen, new = root_mean_squares(errors[ts <= HALF]), root_mean_squares(errors[ts > HALF])
    return {
        "model": name,
        "parameters": len(search.numbers),
        "arm_fitted_rad": seen[0],
        "pendulum_fitted_rad": seen[1],
        "arm_held_out_rad": new[0],
        "pendulum_held_out_rad": new[1],
        "sum_of_squares_whole": f"{whole.cost:.5f}",
        "arm_at_rest_rad": f"{(errors + angles)[-1, 0]:.4f}",
        "estimates": "; ".join(
            f"{key} {value:.4g} (+-{fit.standard_deviations[key]:.1g})" for key, value in search.numbers.items()
        ),
    }


def _begun_at(start, estimate):
    """A parameter with the same scale that begins elsewhere."""
    return sj.Parameter(estimate, scale=start.scale) if isinstance(start, sj.Parameter) else float(estimate)


def _figure(ts, angles, published, own):
    """Both angles; the arm as it comes to rest; how residuals of neighbouring samples are related."""
    figure, ((arm, pendulum), (rest, white)) = plt.subplots(2, 2, figsize=(10, 6.5), layout="constrained")
    for panel, column, title in ((arm, 0, "arm"), (pendulum, 1, "pendulum")):
        panel.plot(ts, angles[:, column], ".", color=GRAY, markersize=3, label="record")
        panel.plot(ts, own[:, column], color=BLUE, linewidth=1, label="two moments, fitted here")
        panel.set(title=f"{title}: angle [rad]", xlabel="t [s]")
    arm.legend(loc="upper right", fontsize=8)
    late = ts >= 15
    rest.plot(ts[late], angles[late, 0], ".", color=GRAY, markersize=3, label="record")
    rest.plot(ts[late], published[late, 0], color=ORANGE, linewidth=1.2, label="published numbers")
    rest.plot(ts[late], own[late, 0], color=BLUE, linewidth=1.2, label="fitted here")
    rest.set(title="the arm comes to rest: angle [rad]", xlabel="t [s]")
    rest.legend(loc="upper right", fontsize=8)
    lags = np.arange(1, 21)
    for column, name, color in ((0, "arm", BLUE), (1, "pendulum", ORANGE)):
        errors = (own - angles)[:, column]
        errors = errors - errors.mean()
        correlation = [np.mean(errors[lag:] * errors[:-lag]) / np.mean(errors**2) for lag in lags]
        white.plot(lags * (ts[1] - ts[0]), correlation, ".-", color=color, label=name)
    white.axhspan(-2 / np.sqrt(len(ts)), 2 / np.sqrt(len(ts)), color=GRAY, alpha=0.25, label="white noise, 95 %")
    white.set(title="correlation of residuals", xlabel="time between samples [s]", ylim=(-0.3, 1.0))
    white.legend(loc="upper right", fontsize=8)
    return figure
