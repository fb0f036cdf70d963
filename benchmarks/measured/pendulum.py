"""Free swings of one arm on a ball bearing: a friction law by its decay.

Angles are those of the arm from upright, z points up, the arm turns about y.
"""

from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import spherejax as sj
from measured.arms import AXIS, angle_of, arm, bearing, drag
from measured.comparing import BLUE, GRAY, ORANGE, Part, fitted, predicted
from measured.records import Record, read, root_mean_square, state_at

GRAVITY = 9.81
PUBLISHED = {"mass": 0.0938, "center": 0.1086, "inertia": 4.375e-4}
"""Of the arm [kg, m, kg m^2 about the center], as published for the same arm with a second one below it."""

RADIUS, RATE = 0.004, 1e-2
"""Of the bearings [m], and the angular speed at which three quarters of a dry moment act [rad/s]."""


def gravity(tilt=0.0):
    """Gravity by the angle between the encoder's zero and upright [rad]."""
    return GRAVITY * jnp.stack([jnp.sin(tilt), 0.0 * jnp.asarray(tilt), -jnp.cos(tilt)])


def single(angle, rate, *, inertia=PUBLISHED["inertia"], tilt=0.0, viscous=0.0, square=None, moment=None, mu=None):
    """One arm."""
    body = arm(PUBLISHED["mass"], PUBLISHED["center"], inertia, angle, rate)
    hinge = bearing(moment, mu, radius=RADIUS, rate=RATE)
    return sj.Scene(
        {"arm": body},
        {"bearing": sj.Revolute(("ground", "arm"), (0.0, 0.0, 0.0), AXIS, hinge)},
        {"encoder": drag(("ground", "arm"), viscous, square)},
        gravity=gravity(tilt),
    )


arm_angle = angle_of("arm", "encoder")
"""Angle of the arm from upright [rad]."""

MODELS = {
    "viscous": {"viscous": 8.8e-5},
    "dry moment, air drag": {"moment": 2.4e-4, "square": 6.7e-6},
    "friction by reaction, air drag": {"mu": 0.06, "square": 9.0e-6},
}
"""Friction parameters of each model: N m s/rad, N m, N m s^2/rad^2, 1."""

SPAN, DEGREE = 0.06, 5
"""Samples within this time [s], and the polynomial's degree, for the state at the beginning of a record."""

EVERY = 4
"""Every so many of the samples are fitted: 20 ms of 5 ms."""


def decays(folder: Path) -> list[Record]:
    """The three records of one arm, angles alone."""
    records = [read(folder, f"pendulum_single_{number}.csv") for number in (1, 2, 3)]
    return [record._replace(values=record.values[:, :1]) for record in records]


def start_of(record: Record) -> tuple[float, float]:
    """Angle [rad] and rate [rad/s] at the beginning of a record."""
    values, rates = state_at(record, record.times[0], SPAN, DEGREE)
    return float(values[0]), float(rates[0])


def build_for(number: int, friction: tuple[str, ...]):
    """From the parameters of all experiments to the arm of one of them."""

    def build(**numbers):
        laws = {name: numbers[name] for name in friction}
        start = numbers[f"angle_{number}"], numbers[f"rate_{number}"]
        return single(*start, inertia=numbers["inertia"], tilt=numbers["tilt"], **laws)

    return build


def fit_decays(records: dict[int, Record], friction: dict[str, float]):
    """Common inertia, tilt and friction of several records with a start of their own."""
    start = {"inertia": 4.54e-4, "tilt": sj.Parameter(1e-3, scale=1e-3), **friction}
    experiments = []
    for number, record in records.items():
        angle, rate = start_of(record)
        start[f"angle_{number}"] = sj.Parameter(angle, scale=1e-3)
        start[f"rate_{number}"] = sj.Parameter(rate, scale=1e-2)
        thinned = Record(record.times[::EVERY] - record.times[0], record.values[::EVERY])
        experiments.append(
            sj.Measured(
                thinned.times,
                {"angle": thinned.values[:, 0]},
                functions={"angle": arm_angle},
                build=build_for(number, tuple(friction)),
                name=f"record {number}",
            )
        )
    build = build_for(next(iter(records)), tuple(friction))
    method = sj.studies.LevenbergMarquardt(max_iterations=25)
    return fitted(build, start, experiments, noise=1e-3, method=method)


def predict_decay(record: Record, estimates, friction) -> np.ndarray:
    """Angles of a record that was not fitted, from its first samples on [rad]."""
    laws = {name: estimates[name] for name in friction}
    scene = single(*start_of(record), inertia=estimates["inertia"], tilt=estimates["tilt"], **laws)
    return predicted(scene, record.times - record.times[0], {"angle": arm_angle})[:, 0]


def study(folder: Path) -> Iterator[Part]:
    """Each record predicted from the others, by each law."""
    records = dict(enumerate(decays(folder), start=1))
    rows, errors = [], {}
    for name, friction in MODELS.items():
        for held_out in (3, 1, 2):
            others = {number: record for number, record in records.items() if number != held_out}
            fit, search = fit_decays(others, friction)
            prediction = predict_decay(records[held_out], fit.estimates, friction)
            errors[name, held_out] = prediction - records[held_out].values[:, 0]
            size = root_mean_square(fit.tables[0] * 1e-3), root_mean_square(fit.tables[1] * 1e-3)
            rows.append(
                {
                    "friction": name,
                    "fitted_records": " and ".join(map(str, others)),
                    "residual_mrad": f"{1e3 * root_mean_square(size):.2f}",
                    "held_out_record": held_out,
                    "held_out_mrad": f"{1e3 * root_mean_square(errors[name, held_out]):.1f}",
                    "estimates": "; ".join(
                        f"{key} {search.numbers[key]:.4g} (+-{fit.standard_deviations[key]:.1g})" for key in friction
                    ),
                    "runs": search.runs,
                    "processor_seconds": f"{search.seconds:.1f}",
                }
            )
    yield "predictions", rows
    yield "figure", _figure(records, errors)


def _figure(records, errors):
    """The whole decay, and the errors in each record that was held out."""
    figure, (decay, wrong) = plt.subplots(2, 1, figsize=(9, 6), sharex=True, layout="constrained")
    for number, record in records.items():
        decay.plot(record.times, record.values[:, 0] - np.pi, color=GRAY, linewidth=0.8)
        decay.axvline(record.times[0], color="black", linewidth=0.5)
        for name, color in zip(MODELS, (ORANGE, BLUE, "#8f1f7e"), strict=True):
            label = name if number == 1 else None
            wrong.plot(record.times, 1e3 * errors[name, number], color=color, linewidth=0.9, label=label)
        wrong.axvline(record.times[0], color="black", linewidth=0.5)
    decay.set(title="the record, in three parts: angle from hanging [rad]")
    wrong.set(title="error of the prediction of each part, by a fit to the other two [mrad]", xlabel="t [s]")
    wrong.legend(loc="upper right", fontsize=8)
    return figure
