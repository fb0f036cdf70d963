"""Magnitudes that papers print: loci of journal bearings on charts, friction moments in hip prostheses.

The records behind them are not at hand; what a model gives is compared with the printed numbers.
"""

from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import spherejax as sj
from measured.comparing import BLUE, GRAY, ORANGE, Part

CHART = {
    0.25: ((0.1, 16.2, 82.31), (0.2, 7.57, 75.18), (0.4, 2.83, 60.86), (0.6, 1.07, 46.72), (0.8, 0.261, 31.04),
           (0.9, 0.0736, 21.85)),
    0.5: ((0.1, 4.31, 81.62), (0.2, 2.03, 74.94), (0.4, 0.779, 61.45), (0.6, 0.319, 48.14), (0.8, 0.0923, 33.31),
          (0.9, 0.0313, 23.66)),
    1.0: ((0.1, 1.33, 79.5), (0.2, 0.631, 74.02), (0.4, 0.264, 63.1), (0.6, 0.121, 50.58), (0.8, 0.0446, 36.24),
          (0.9, 0.0188, 26.45)),
}  # fmt: skip
"""By length over diameter: eccentricity ratio, Sommerfeld number, attitude angle [degrees] of full journal bearings
whose film ruptures. Raimondi and Boyd (1958), ASLE Transactions 1, 159-209, who solved Reynolds' equation by
differences; a solution of our own agrees with these Sommerfeld numbers to 3 percent."""

DIAMETER, CLEARANCE, VISCOSITY, FREQUENCY = 0.01, 5e-6, 0.01, 50.0
"""Of the computed bearing [m, m, Pa s, 1/s]. What is compared does not depend on them."""

FILM_OFFSET = 1e-11
"""Of the film's thickness [m]: none to speak of, as the charts have it."""

HIP_WEIGHT, HEAD_RADIUS, PEAK = 750.0, 0.016, 2.48
"""Body weight [N], radius of the head [m], largest contact force in walking over the body weight [-]."""

FLEXION = np.pi / 9
"""Amplitude of a leg's swing, one cycle a second, as in the gallery's hip [rad]."""

HIP_COEFFICIENTS = (0.04, 0.06, 0.14)
"""Of friction, averages of Damm and others (2013), PLoS ONE 8(11):e78373: at toe off and at heel strike of the other
leg, and at toe off of the own one."""


def journal(load, length, *, seconds=0.08):
    """A rotor in a short bearing that is loaded until it runs where it stays.

    Args:
        load: downwards [N].
        length: of the bearing [m].
        seconds: until when.

    Returns:
        Eccentricity ratio [-] and attitude angle [rad].
    """
    model = sj.Lubricated(
        CLEARANCE, VISCOSITY, socket_radius=DIAMETER / 2, normal=sj.Hertz(stiffness=1e9),
        film=sj.laws.ShortBearing(length), e_h0=FILM_OFFSET, e_h1=FILM_OFFSET,
    )  # fmt: skip
    spin = 2 * np.pi * FREQUENCY
    rotor = sj.Body(0.1, (10.0, 10.0, 10.0), angular_velocity=(0.0, 0.0, spin))
    bearing = sj.Revolute(("ground", "rotor"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), model)
    down = jnp.stack([0.0 * load, -load, 0.0 * load])
    scene = sj.Scene(
        {"rotor": rotor}, {"bearing": bearing}, {"load": sj.AppliedWrench("rotor", force=down)}, gravity=(0.0, 0.0, 0.0)
    )
    run = sj.simulate(scene, jnp.array([0.0, seconds]))
    place = run.position("rotor")[-1]
    return jnp.hypot(place[0], place[1]) / CLEARANCE, jnp.arctan2(place[0], -place[1])


def charted_load(length_ratio: float, sommerfeld: float) -> float:
    """The load of a Sommerfeld number S = (mu N L D / W) (R/c)^2 [N]."""
    size = VISCOSITY * FREQUENCY * length_ratio * DIAMETER**2
    return size * (DIAMETER / 2 / CLEARANCE) ** 2 / sommerfeld


def loci() -> list[dict[str, object]]:
    """Where the short bearing runs at the loads of the chart."""
    where = jax.jit(journal)
    rows = []
    for ratio, points in CHART.items():
        for eccentricity, sommerfeld, attitude in points:
            own, angle = where(charted_load(ratio, sommerfeld), ratio * DIAMETER)
            rows.append(
                {
                    "length_over_diameter": ratio,
                    "sommerfeld_number": sommerfeld,
                    "charted_eccentricity_ratio": eccentricity,
                    "own_eccentricity_ratio": f"{float(own):.3f}",
                    "charted_attitude_deg": attitude,
                    "own_attitude_deg": f"{np.degrees(float(angle)):.1f}",
                }
            )
    return rows


def walking_hip(mu):
    """Largest friction moment [N m] and mean friction power [W] of a hip in one gait cycle."""
    model = sj.Ideal(friction=sj.Threlfall(mu=mu, v1=1e-3), radius=HEAD_RADIUS, pressure=sj.laws.PointContact())
    free = sj.gallery.hip(model, peak=PEAK * HIP_WEIGHT, swing=0.1 * PEAK * HIP_WEIGHT)
    # The muscles overcome the friction: the flexion is prescribed, so that friction does not shorten the steps.
    walk = sj.RotationDriver(("ground", "femur"), (0.0, 1.0, 0.0), angle=sj.functions.Sine(FLEXION, 1.0))
    scene = sj.Scene(
        free.bodies, {**free.joints, "walk": walk}, free.forces, gravity=free.gravity, ground_points=free.ground_points
    )
    run = sj.simulate(scene, jnp.linspace(0.0, 1.0, 401), rtol=1e-6)
    moments = jnp.linalg.norm(run.part("cup", "friction_moment"), axis=1)
    return jnp.max(moments), jnp.mean(run.part("cup", "friction_power"))


def hips() -> list[dict[str, object]]:
    """Friction of walking hips by coefficient."""
    walk, rows = jax.jit(walking_hip), []
    for mu in HIP_COEFFICIENTS:
        moment, power = walk(mu)
        rows.append(
            {
                "coefficient": mu,
                "peak_moment_percent_BW_m": f"{100 * float(moment) / HIP_WEIGHT:.2f}",
                "mean_power_W": f"{float(power):.1f}",
            }
        )
    return rows


def study(folder: Path) -> Iterator[Part]:
    """No record is read."""
    del folder
    found = loci()
    yield "bearings", found
    yield "hips", hips()
    yield "figure", _figure(found)


def _figure(rows):
    """The journal's center in the clearance circle, charted and computed, and the eccentricity by the load."""
    figure, (circle, by_load) = plt.subplots(1, 2, figsize=(10, 4.8), layout="constrained")
    quarter = np.radians(np.linspace(0.0, 90.0, 91))
    circle.plot(np.sin(quarter), -np.cos(quarter), color="black", linewidth=0.8)
    for ratio, color in zip(CHART, (BLUE, ORANGE, GRAY), strict=True):
        these = [row for row in rows if row["length_over_diameter"] == ratio]
        charted, own = (
            np.array(
                [[float(row[f"{who}_{what}"]) for row in these] for what in ("eccentricity_ratio", "attitude_deg")]
            )
            for who in ("charted", "own")
        )
        numbers = [float(row["sommerfeld_number"]) for row in these]
        for values, style in ((charted, "o"), (own, "-")):
            angle = np.radians(values[1])
            label = f"L/D = {ratio:g}, " + ("charted" if style == "o" else "simulated")
            circle.plot(values[0] * np.sin(angle), -values[0] * np.cos(angle), style, color=color, label=label)
            by_load.plot(numbers, values[0], style, color=color, label=label)
    circle.set(aspect="equal", title="place of the journal's center, the load downwards [clearance]")
    by_load.set(xscale="log", xlabel="Sommerfeld number", title="eccentricity ratio")
    by_load.legend(fontsize=8)
    return figure
