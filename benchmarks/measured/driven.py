"""A driven double pendulum: friction of two geared motors by free swings after the motors are switched off.

In each record the motors lift both links within 5 s, then their moments drop to nothing. Angles of the file are those
of the first link from hanging and of the second link against the first; z points up, the links turn about y.

The rotor of the elbow's motor is a body of its own on the first link, and a stiff `Coupler` turns it by the gear ratio.
The shoulder's rotor turns against the ground alone: its inertia, by the square of the ratio, is exactly one of the
first link.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import spherejax as sj
from measured.arms import AXIS, angle_of, arm, bearing, drag, end_of
from measured.comparing import BLUE, GRAY, ORANGE, Part, fitted
from measured.records import Record, read, state_at

GRAVITY = 9.81
LENGTH = 0.3
"""Distance of the two axes [m]."""

MASSES, CENTERS = (0.559, 0.604), (0.3, 0.184)
"""Of the links, as published [kg], and of their centers from the axes [m]."""

PUBLISHED = {
    "first_inertia": 0.0535, "second_inertia": 0.0239, "rotor": 7.66e-5,
    "first_moment": 0.093, "second_moment": 0.078, "first_viscous": 0.001, "second_viscous": 0.001,
}  # fmt: skip
"""The laboratory's model 2.0: moments of inertia about the axes and of a rotor [kg m^2], friction [N m, N m s/rad]."""

GEAR = -6.0
"""Turns of the rotor for one of the elbow; the sign is that of the published mass matrix."""

ROTOR_MASS = 1e-3
"""Of the body that carries the elbow rotor's inertia [kg]: on the axis, where it moves nothing of the rest."""

TEETH, TEETH_DAMPING = 100.0, 0.3
"""Stiffness and damping of the elbow's gear, at the link [N m/rad, N m s/rad]: the rotor would vibrate with 30 Hz."""

RADIUS, RATE = 0.02, 1e-2
"""Of the motors' bearings [m], and the angular speed at which three quarters of a dry moment act [rad/s]."""


def driven(
    angles, rates, *, first_inertia, second_inertia, rotor, weights=(1.0, 1.0), first_moment=None, second_moment=None,
    first_viscous=0.0, second_viscous=0.0, first_mu=None, second_mu=None, breakaway=None, stribeck_rate=RATE, gear=GEAR,
):  # fmt: skip
    """Both links and the elbow's rotor, without moments of the motors.

    Args:
        angles, rates: of the first link from hanging, and of the second against it [rad, rad/s].
        first_inertia, second_inertia: about the axes [kg m^2].
        rotor: moment of inertia of each rotor [kg m^2].
        weights: factors of the published distances of the centers of mass [-].
        first_moment, second_moment: dry friction without load [N m].
        first_viscous, second_viscous: [N m s/rad].
        first_mu, second_mu: coefficients of friction that follows the reaction [-].
        breakaway: of both joints, how much larger the dry moment is as turning begins, as a share [-].
        stribeck_rate: angular speed where a dry moment with `breakaway` is largest [rad/s].
        gear: turns of the elbow's rotor against the first link for one of the second.
    """
    centers = [center * weight for center, weight in zip(CENTERS, weights, strict=True)]
    inertias = [x - m * c**2 for x, m, c in zip((first_inertia, second_inertia), MASSES, centers, strict=True)]
    upper, lower = jnp.pi + angles[0], jnp.pi + angles[0] + angles[1]
    elbow, speed = end_of(LENGTH, upper, rates[0])
    turning = rates[0] + gear * rates[1]
    bodies = {
        "first": arm(MASSES[0], centers[0], inertias[0] + GEAR**2 * rotor, upper, rates[0]),
        "second": arm(MASSES[1], centers[1], inertias[1], lower, rates[0] + rates[1], elbow, speed),
        "rotor": sj.Body(
            ROTOR_MASS,
            (rotor, rotor, rotor),
            elbow,
            velocity=speed,
            angular_velocity=turning * jnp.array(AXIS),
        ),
    }
    hinges = [
        bearing(moment, mu, breakaway, radius=RADIUS, rate=RATE if breakaway is None else stribeck_rate)
        for moment, mu in ((first_moment, first_mu), (second_moment, second_mu))
    ]
    joints = {
        "shoulder": sj.Revolute(("ground", "first"), (0.0, 0.0, 0.0), AXIS, hinges[0]),
        "elbow": sj.Revolute(("first", "second"), elbow, AXIS, hinges[1]),
        "motor": sj.Revolute(("first", "rotor"), elbow, AXIS),
    }
    forces = {
        "encoder": drag(("ground", "first"), first_viscous),
        "elbow_encoder": drag(("first", "second"), second_viscous),
        "second_encoder": drag(("ground", "second")),
        "gear": sj.forces.Coupler(
            sj.Turn(("first", "rotor"), AXIS),
            sj.Turn(("first", "second"), AXIS),
            ratio=1.0 / gear,
            stiffness=TEETH,
            damping=TEETH_DAMPING,
        ),
    }
    return sj.Scene(bodies, joints, forces, gravity=(0.0, 0.0, -GRAVITY))


def first_angle(run):
    """Of the first link from hanging [rad]."""
    return angle_of("first", "encoder")(run) - jnp.pi


def elbow_angle(run):
    """Of the second link against the first [rad]."""
    return angle_of("second", "second_encoder")(run) - angle_of("first", "encoder")(run)


FUNCTIONS = {"first": first_angle, "elbow": elbow_angle}
DRY = {"first_moment": 0.1, "second_moment": 0.1}
VISCOUS = {"first_viscous": 0.005, "second_viscous": 0.005}
MODELS = {
    "viscous": VISCOUS,
    "dry": DRY,
    "dry, viscous": {**DRY, **VISCOUS},
    "dry, viscous, by reaction": {**DRY, **VISCOUS, "first_mu": 0.05, "second_mu": 0.05},
    "Stribeck, viscous": {**DRY, **VISCOUS, "breakaway": 0.3, "stribeck_rate": 0.1},
}
"""Friction of each model, where its fit begins."""

INERTIAS = {name: PUBLISHED[name] for name in ("first_inertia", "second_inertia")} | {"rotor": 1.3e-4}
"""What is fitted with all of them, and where the fit begins [kg m^2]."""

NAMES = ("20220812-060143", "20220812-060245")
RELEASE, LIFTING = 5.03, (1.0, 4.9)
"""When a free swing begins, some samples after the last moment of a motor; and when the links are lifted [s]."""

SPAN, DEGREE = 0.06, 4
"""Samples within this time [s], and the polynomial's degree, for the state at the release."""

NOISE, FAR = 0.01, 0.1
"""An error of the models for the weights of a fit, and one at which a prediction ends [rad]."""


def free_swing(record: Record) -> Record:
    """Both angles after the motors are switched off."""
    return Record(record.times, record.values[:, :2]).part(RELEASE, record.times[-1])


def experiment_of(name: str, swing: Record) -> sj.Measured:
    """A free swing; the rates at its beginning are fitted to it, for the motors' loops leave a shaking behind."""
    angles, rates = state_at(swing, swing.times[0], SPAN, DEGREE)
    own = {
        "first_rate": sj.Parameter(float(rates[0]), scale=0.3),
        "elbow_rate": sj.Parameter(float(rates[1]), scale=0.3),
    }

    def build(first_rate, elbow_rate, **numbers):
        return driven(tuple(angles), (first_rate, elbow_rate), **numbers)

    values = dict(zip(FUNCTIONS, swing.values.T, strict=True))
    times = swing.times - swing.times[0]
    return sj.Measured(times, values, functions=FUNCTIONS, build=build, name=name, own=own)


def study(folder: Path) -> Iterator[Part]:
    """Each free swing predicted from the other one, by each friction law; and friction while the links are lifted."""
    records = {name: read(folder, f"dfki_double_{name}.csv") for name in NAMES}
    yield "lifting", [row for name, record in records.items() for row in lifting(name, record)]
    swings = {name: free_swing(record) for name, record in records.items()}
    experiments = {name: experiment_of(name, swing) for name, swing in swings.items()}
    rows, shown = [], {}
    for model, friction in MODELS.items():
        for seen, new in (NAMES, NAMES[::-1]):
            fit, search = fit_swing(experiments[seen], experiments[new], friction)
            validation = fit.validation
            assert validation is not None
            sizes = {one.component: f"{1e3 * one.rms:.0f}" for one in validation.errors}
            until = {name: validation.within(FAR, name)[new] for name in FUNCTIONS}
            own = np.sqrt(np.nanmean(np.square(fit.tables[0] * NOISE), 0))
            rows.append(
                {
                    "friction": model,
                    "fitted_record": seen[-6:],
                    "residual_mrad": ", ".join(f"{1e3 * size:.0f}" for size in own),
                    "held_out_record": new[-6:],
                    "first_mrad": sizes["first"],
                    "elbow_mrad": sizes["elbow"],
                    "within_0.1_rad_s": ", ".join(f"{time:.2f}" for time in until.values()),
                    "estimates": "; ".join(
                        f"{key} {float(fit.estimates[key]):.3g} (+-{fit.standard_deviations[key]:.1g})"
                        for key in (*friction, *INERTIAS)
                    ),
                    "runs": search.runs,
                    "processor_seconds": f"{search.seconds:.1f}",
                }
            )
            shown[model, new] = validation.differences[new]
    yield "predictions", rows
    yield "figure", _figure(swings, shown)


def fit_swing(measured: sj.Measured, held_out: sj.Measured, friction: Mapping[str, Any]):
    """Friction and moments of inertia from one free swing, and the prediction of another one."""
    method = sj.studies.LevenbergMarquardt(max_iterations=30)
    start = {**INERTIAS, **friction}
    return fitted(measured.build, start, measured, validate=held_out, noise=NOISE, rtol=1e-6, method=method)


def lifting(name: str, record: Record) -> Iterator[dict[str, object]]:
    """What the motors' moments exceed the weights by, on average, while the links turn slowly [N m]."""
    slow = record.part(*LIFTING)
    first, second = slow.values[:, 0], slow.values[:, 0] + slow.values[:, 1]
    lower = GRAVITY * MASSES[1] * CENTERS[1] * np.sin(second)
    upper = GRAVITY * (MASSES[0] * CENTERS[0] + MASSES[1] * LENGTH) * np.sin(first) + lower
    joints = (("first", upper, 0), ("elbow", lower, 1))
    for (joint, weight, column), law in zip(joints, ("first_moment", "second_moment"), strict=True):
        excess = slow.values[:, 4 + column] - weight
        rates = np.polyfit(slow.times, slow.values[:, column], 1)
        yield {
            "record": name[-6:],
            "joint": joint,
            "mean_rate_rad_s": f"{rates[0]:.2f}",
            "mean_excess_N_m": f"{np.mean(excess):.3f}",
            "scatter_N_m": f"{np.std(excess):.2f}",
            "published_dry_friction_N_m": f"{np.sign(rates[0]) * PUBLISHED[law]:.3f}",
        }


def _figure(swings, shown):
    """Both angles of each swing, as the other one predicts it by two laws."""
    figure, panels = plt.subplots(2, 2, figsize=(10, 6.5), sharex=True, layout="constrained")
    for column, name in enumerate(NAMES):
        swing = swings[name]
        for row, (angle, title) in enumerate((("first", "first link"), ("elbow", "elbow"))):
            panel, values = panels[row][column], swing.values[:, row]
            panel.plot(swing.times, values, color=GRAY, linewidth=2, label="record")
            for model, color in (("viscous", ORANGE), ("dry, viscous", BLUE)):
                prediction = values + shown[model, name][angle]
                panel.plot(swing.times, prediction, color=color, linewidth=1, label=f"predicted, {model}")
            panel.set_title(f"{title}, record {name[-6:]}: angle [rad]", loc="left", fontsize=10)
    figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)
    for panel in panels[1]:
        panel.set(xlabel="t [s]")
    return figure
