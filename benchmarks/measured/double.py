"""Free swings of two arms, one below the other: how long models predict a chaotic motion.

Angles are those of both arms from upright in space, z points up, the arms turn about y.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import spherejax as sj
from measured.arms import AXIS, angle_of, arm, bearing, drag, end_of
from measured.comparing import BLUE, GRAY, ORANGE, Part, fitted, predicted, root_mean_squares
from measured.records import Record, read, state_at

GRAVITY = 9.81
MASSES, CENTERS, INERTIAS = (0.0938, 0.1376), (0.1086, 0.1168), (4.375e-4, 1.2688e-3)
"""Published numbers of both arms [kg, m, kg m^2 about the center]."""

LENGTH = 0.1727
"""Distance of the two bearings [m]."""

PUBLISHED = {"first_viscous": 2.37e-4, "second_viscous": 1.0e-5}
"""Published friction of both bearings [N m s/rad]."""

RADIUS, RATE = 0.004, 1e-2
"""Of the bearings [m], and the angular speed at which three quarters of a dry moment act [rad/s]."""

SPAN, DEGREE = 0.03, 5
"""Samples within this time [s], and the polynomial's degree, for the state at the beginning of a record."""

FAR = 0.1
"""An error of an angle at which a prediction ends [rad]."""


def double(
    angles, rates, *, first_viscous=0.0, second_viscous=0.0, first_square=None, second_square=None, first_moment=None,
    second_moment=None, first_inertia=INERTIAS[0], second_inertia=INERTIAS[1], second_center=CENTERS[1], tilt=0.0,
):  # fmt: skip
    """Two arms, the second at the end of the first.

    Args:
        angles, rates: of both arms in space, from upright [rad, rad/s].
        first_viscous, second_viscous: [N m s/rad].
        first_square, second_square: resistance of each arm by the square of its speed in space, as of air
            [N m s^2/rad^2].
        first_moment, second_moment: dry moments of the bearings [N m].
        first_inertia, second_inertia: about the centers [kg m^2].
        second_center: of the second arm, from its bearing [m].
        tilt: angle between the encoders' zero and upright [rad].
    """
    elbow, speed = end_of(LENGTH, angles[0], rates[0])
    bodies = {
        "first": arm(MASSES[0], CENTERS[0], first_inertia, angles[0], rates[0]),
        "second": arm(MASSES[1], second_center, second_inertia, angles[1], rates[1], elbow, speed),
    }
    hinges = [bearing(moment, radius=RADIUS, rate=RATE) for moment in (first_moment, second_moment)]
    joints = {
        "shoulder": sj.Revolute(("ground", "first"), (0.0, 0.0, 0.0), AXIS, hinges[0]),
        "elbow": sj.Revolute(("first", "second"), elbow, AXIS, hinges[1]),
    }
    forces = {
        "encoder": drag(("ground", "first"), first_viscous, first_square),
        "elbow_drag": drag(("first", "second"), second_viscous),
        "second_encoder": drag(("ground", "second"), 0.0, second_square),
    }
    gravity = GRAVITY * jnp.stack([jnp.sin(tilt), 0.0 * jnp.asarray(tilt), -jnp.cos(tilt)])
    return sj.Scene(bodies, joints, forces, gravity=gravity)


FUNCTIONS = {"first": angle_of("first", "encoder"), "second": angle_of("second", "second_encoder")}

SQUARES = {"first_square": 5e-6, "second_square": 5e-6}
BODIES = {
    "first_inertia": INERTIAS[0], "second_inertia": INERTIAS[1], "second_center": CENTERS[1],
    "tilt": sj.Parameter(1e-3, scale=1e-3),
}  # fmt: skip
VISCOUS = {"first_viscous": 2e-4, "second_viscous": 2e-5}
DRY = {"first_moment": 2e-4, "second_moment": 2e-5}
MODELS: dict[str, dict[str, Any]] = {
    "dry moments, air drag, bodies": {**DRY, **SQUARES, **BODIES},
    "viscous, bodies": {**VISCOUS, **BODIES},
    "viscous": VISCOUS,
}
"""What is fitted with each model, and where the fit begins; "bodies" are inertias, a center, and the encoders' zero."""

NOISE = 1e-3
"""Weight of both angles in a fit [rad]: their scatter is smaller, the errors of the models are larger."""

EVERY = 5
"""Every so many of the samples are fitted: 10 ms of 2 ms."""

SPLITS = {2: (3, 4, 5), 4: (1, 2, 3)}
"""To which record a model is fitted, and from the beginnings of which it predicts what it has not seen."""


def start_of(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Angles [rad] and rates [rad/s] at the beginning of a record, by its first samples."""
    return state_at(record, record.times[0], SPAN, DEGREE)


def experiment_of(name: str, record: Record) -> sj.Measured:
    """A record; the rates at its beginning are fitted to it, for its angles are exact and show them less well."""
    angles, (first_rate, second_rate) = start_of(record)
    own = {
        "first_rate": sj.Parameter(float(first_rate), scale=1e-2),
        "second_rate": sj.Parameter(float(second_rate), scale=1e-2),
    }

    def build(first_rate, second_rate, **numbers):
        return double(tuple(angles), (first_rate, second_rate), **numbers)

    times, values = record.times[::EVERY] - record.times[0], dict(zip(FUNCTIONS, record.values[::EVERY].T, strict=True))
    return sj.Measured(times, values, functions=FUNCTIONS, build=build, name=name, own=own)


def fit_swing(name: str, record: Record, model: Mapping[str, Any]):
    """Friction and bodies from one record."""
    experiment = experiment_of(name, record)
    method = sj.studies.LevenbergMarquardt(max_iterations=25)
    return fitted(experiment.build, model, experiment, noise=NOISE, method=method)


def predict_swing(records: list[Record], numbers: Mapping[str, Any]) -> tuple[Record, np.ndarray]:
    """What follows the first 30 ms of a record, over all records that follow each other, and the errors [rad]."""
    swing = Record(*(np.concatenate(parts) for parts in zip(*records, strict=True)))
    angles, rates = start_of(records[0])
    scene = double(tuple(angles), tuple(rates), **numbers)
    return swing, predicted(scene, swing.times - swing.times[0], FUNCTIONS) - swing.values


def within(swing: Record, errors: np.ndarray, limit: float = FAR) -> str:
    """Until when both angles are predicted to within a limit [s], as text."""
    far = np.nonzero(np.max(np.abs(errors), 1) > limit)[0]
    times = swing.times - swing.times[0]
    return f"{times[far[0]]:.2f}" if far.size else f"{times[-1]:.2f}, to the end"


def study(folder: Path) -> Iterator[Part]:
    """The published numbers from the beginning of each record on; then own friction, from what it was not fitted to."""
    names = (1, 2, 3, 4, 5)
    records = {number: read(folder, f"pendulum_double_{number}.csv") for number in names}
    records = {number: record._replace(values=record.values[:, :2]) for number, record in records.items()}
    rows, own, shown = [], [], {}
    for number in names:
        rest = [records[later] for later in names if later >= number]
        swing, errors = predict_swing(rest, PUBLISHED)
        first, second = root_mean_squares(errors[: len(records[number].times)])
        row = {"from_record": number, "first_arm_rad": first, "second_arm_rad": second}
        rows.append({**row, "within_0.1_rad_s": within(swing, errors)})
        shown["published", number, 0] = swing, errors
    yield "predictions", rows
    for (name, model), (seen, begins) in ((a, b) for a in MODELS.items() for b in SPLITS.items()):
        fit, search = fit_swing(f"record {seen}", records[seen], model)
        numbers = {key: fit.estimates[key] for key in model}
        times = {}
        for number in begins:
            # Until the record that was fitted, or the end.
            rest = [records[later] for later in names if later >= number and (number > seen or later < seen)]
            shown[name, number, seen] = swing, errors = predict_swing(rest, numbers)
            times[number] = within(swing, errors)
        own.append(
            {
                "friction": name,
                "fitted_record": seen,
                "residual_mrad": f"{np.sqrt(np.mean([np.mean(table**2) for table in fit.tables])):.2f}",
                "within_0.1_rad_s": "; ".join(f"from {number}: {time}" for number, time in times.items()),
                "estimates": "; ".join(
                    f"{key} {float(numbers[key]):.4g} (+-{fit.standard_deviations[key]:.1g})" for key in model
                ),
                "runs": search.runs,
                "processor_seconds": f"{search.seconds:.1f}",
            }
        )
        yield "own_friction", own
        if name == BEST:
            yield "figure", _figure(shown)


BEST = "dry moments, air drag, bodies"
"""The model of the figure."""


def _figure(shown):
    """The second arm from the third record on, and the errors of both arms by two models."""
    figure, panels = plt.subplots(3, 1, figsize=(9, 7.5), sharex=True, layout="constrained")
    swing, _ = shown["published", 3, 0]
    panels[0].plot(swing.times, swing.values[:, 1] - np.pi, color=GRAY, linewidth=1.8, label="record")
    kinds = (("published", 0, "published friction", ORANGE), (BEST, 2, "own friction, from record 2", BLUE))
    for name, seen, label, color in kinds:
        _, errors = shown[name, 3, seen]
        panels[0].plot(swing.times, (swing.values + errors)[:, 1] - np.pi, color=color, linewidth=0.9, label=label)
        for panel, column in ((panels[1], 0), (panels[2], 1)):
            panel.plot(swing.times, errors[:, column], color=color, linewidth=0.9)
    panels[0].set_title("second arm: angle from hanging [rad]", loc="left")
    panels[0].legend(loc="lower right", ncols=3, fontsize=8, bbox_to_anchor=(1.0, 1.0))
    for panel, name in ((panels[1], "first"), (panels[2], "second")):
        panel.axhspan(-FAR, FAR, color=GRAY, alpha=0.2)
        panel.set_title(f"{name} arm: error of the prediction [rad]", loc="left")
        panel.set_ylim(-0.6, 0.6)
    panels[2].set(xlabel="t [s]")
    return figure
