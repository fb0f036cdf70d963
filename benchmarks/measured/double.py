"""Free swings of two arms, one below the other: how long the published model predicts a chaotic motion.

Angles are those of both arms from upright in space, z points up, the arms turn about y.
"""

from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import spherejax as sj
from measured.comparing import BLUE, GRAY, Part, predicted, root_mean_squares
from measured.records import Record, read, state_at

GRAVITY = 9.81
FIRST = {"mass": 0.0938, "center": 0.1086, "inertia": 4.375e-4}
SECOND = {"mass": 0.1376, "center": 0.1168, "inertia": 1.2688e-3}
LENGTH = 0.1727
"""Published numbers of both arms [kg, m, kg m^2 about the center], and the distance of the two bearings [m]."""

VISCOUS = 2.37e-4, 1.0e-5
"""Published friction of both bearings [N m s/rad]."""

SPAN, DEGREE = 0.03, 5
"""Samples within this time [s], and the polynomial's degree, for the state at the beginning of a record."""

FAR = 0.1
"""An error of an angle at which a prediction ends [rad]."""

AXIS = (0.0, 1.0, 0.0)


def arm(mass, center, inertia, top, angle, rate, velocity_of_top):
    """An arm that hangs at `top` [m] and stands at an angle from upright [rad]."""
    s, c = jnp.sin(angle), jnp.cos(angle)
    zero = jnp.zeros_like(s)
    out = center * jnp.stack([s, zero, c])
    return sj.Body(
        mass,
        (inertia, inertia, inertia),
        top + out,
        quaternion=jnp.stack([jnp.cos(angle / 2), zero, jnp.sin(angle / 2), zero]),
        velocity=velocity_of_top + rate * center * jnp.stack([c, zero, -s]),
        angular_velocity=rate * jnp.array(AXIS),
    )


def double(angles, rates):
    """Two arms, the second at the end of the first."""
    s, c = jnp.sin(angles[0]), jnp.cos(angles[0])
    zero, rest = jnp.zeros_like(s), jnp.zeros(3)
    elbow = LENGTH * jnp.stack([s, zero, c])
    speed = rates[0] * LENGTH * jnp.stack([c, zero, -s])
    bodies = {
        "first": arm(**FIRST, top=rest, angle=angles[0], rate=rates[0], velocity_of_top=rest),
        "second": arm(**SECOND, top=elbow, angle=angles[1], rate=rates[1], velocity_of_top=speed),
    }
    joints = {
        "shoulder": sj.Revolute(("ground", "first"), (0.0, 0.0, 0.0), AXIS),
        "elbow": sj.Revolute(("first", "second"), elbow, AXIS),
    }
    forces = {
        "encoder": sj.TorsionalSpring(("ground", "first"), AXIS, damping=VISCOUS[0]),
        "elbow_drag": sj.TorsionalSpring(("first", "second"), AXIS, damping=VISCOUS[1]),
        "second_encoder": sj.TorsionalSpring(("ground", "second"), AXIS),
    }
    return sj.Scene(bodies, joints, forces, gravity=(0.0, 0.0, -GRAVITY))


def angle_of(body, encoder):
    """From a run to the angle of an arm from upright [rad]."""

    def angle(run):
        w, _, y, _ = run.quaternion(body)[0]
        return run.force(encoder)["angle"] + 2 * jnp.arctan2(y, w)

    return angle


FUNCTIONS = {"first": angle_of("first", "encoder"), "second": angle_of("second", "second_encoder")}


def study(folder: Path) -> Iterator[Part]:
    """Each record from the state at its beginning; then all that follow it, for they are one swing."""
    records = [read(folder, f"pendulum_double_{number}.csv") for number in (1, 2, 3, 4, 5)]
    records = [record._replace(values=record.values[:, :2]) for record in records]
    rows, shown = [], {}
    for number in range(len(records)):
        rest = records[number:]
        swing = Record(*(np.concatenate(parts) for parts in zip(*rest, strict=True)))
        angles, rates = state_at(records[number], swing.times[0], SPAN, DEGREE)
        times = swing.times - swing.times[0]
        errors = predicted(double(tuple(angles), tuple(rates)), times, FUNCTIONS) - swing.values
        far = np.nonzero(np.max(np.abs(errors), 1) > FAR)[0]
        inside = errors[: len(records[number].times)]
        first, second = root_mean_squares(inside)
        rows.append(
            {
                "from_record": number + 1,
                "first_arm_rad": first,
                "second_arm_rad": second,
                "within_0.1_rad_s": f"{times[far[0]]:.2f}" if far.size else f"{times[-1]:.2f}, to the end",
            }
        )
        shown[number + 1] = swing, errors
    yield "predictions", rows
    yield "figure", _figure(*shown[2])


def _figure(swing, errors):
    """The second arm from the second record on, and the errors of both."""
    figure, (angle, wrong) = plt.subplots(2, 1, figsize=(9, 5.5), sharex=True, layout="constrained")
    angle.plot(swing.times, swing.values[:, 1] - np.pi, color=GRAY, linewidth=1.5, label="record")
    angle.plot(swing.times, (swing.values + errors)[:, 1] - np.pi, color=BLUE, linewidth=0.9, label="predicted")
    angle.set(title="second arm: angle from hanging [rad]")
    angle.legend(loc="upper right", fontsize=8)
    wrong.plot(swing.times, errors[:, 0], color=GRAY, linewidth=0.9, label="first arm")
    wrong.plot(swing.times, errors[:, 1], color=BLUE, linewidth=0.9, label="second arm")
    wrong.axhspan(-FAR, FAR, color=GRAY, alpha=0.2)
    wrong.set(title="error of the prediction [rad]", xlabel="t [s]")
    wrong.legend(loc="upper left", fontsize=8)
    return figure
