"""What the figures of one mechanism draw: the histories of a body and of a joint, as plain host arrays.

A trajectory observes everything; a figure needs a few curves of it. Drawing code sees only `Curves`, so it
can be used with results that come from elsewhere, and a long study does not hold on to whole trajectories.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.motion.results.trajectory import Trajectory
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.dry import Dry
from spherejax.physics.joints.elementary import PlacedPair
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.lubricated import Lubricated

AXES = ("x", "y", "z")
"""World axes along which the center of a body is followed."""

ROTATIONS = tuple(f"rotation.{axis}" for axis in AXES)
"""The same of a body that turns in one place: its angle about a world axis."""

HARDLY_MOVES = 1e-3
"""A body whose center moves by less than this share of what its rotation moves (its radius of gyration times the angle)
is followed by its angle."""


@dataclass(frozen=True)
class Curves:
    """The motion of a body along one direction, the energy, and the eccentricity of a joint.

    Attributes:
        label: what the legend says.
        ts: sample times [s], shape (n,).
        position: of the body's center of mass along `axis` [m], or its angle about it [rad], shape (n,).
        velocity: its rate [m/s, rad/s], shape (n,).
        acceleration: its second rate [m/s^2, rad/s^2], shape (n,).
        energy_change: mechanical energy minus that at the start [J], shape (n,).
        eccentricity: socket center to ball center, world axes [m], shape (n, 3); zero for a joint that keeps it so.
        sliding_speed: of the contact points [m/s], shape (n,); None for a joint without friction.
        clearance: radial clearance of the joint [m]; None for a joint without clearance.
        body: whose motion it is; figures name it on their axes.
        axis: along which world axis, x, y or z; or rotation.x, rotation.y, rotation.z.
        kind: kind of the joint's model, which has a color of its own in all figures: ideal, dry, friction, lubricated
            or bushing; empty for another one.
        supplied: what drivers and forces have put in since the start [J], shape (n,); None where nothing can.
        penetration: of the joint's surfaces [m], shape (n,); None: |e| - c.
    """

    label: str
    ts: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    energy_change: np.ndarray
    eccentricity: np.ndarray
    sliding_speed: np.ndarray | None = None
    clearance: float | None = None
    body: str = ""
    axis: str = "z"
    kind: str = ""
    supplied: np.ndarray | None = None
    penetration: np.ndarray | None = None

    @property
    def distance(self) -> np.ndarray:
        """|e| [m], shape (n,)."""
        return np.linalg.norm(self.eccentricity, axis=1)

    @property
    def touching(self) -> np.ndarray:
        """Whether the surfaces touch, shape (n,); never those of a joint without clearance."""
        if self.clearance is None:
            return np.zeros(len(self.ts), bool)
        return self.distance >= self.clearance if self.penetration is None else self.penetration >= 0.0

    @property
    def energy_balance(self) -> np.ndarray:
        """The change of mechanical energy less what was put in [J], shape (n,): minus the energy that was lost."""
        return self.energy_change if self.supplied is None else self.energy_change - self.supplied

    @property
    def lost_energy(self) -> float:
        """What was lost until the last sample that the run reached [J]: put in and no longer there."""
        there = self.energy_balance[np.isfinite(self.energy_balance)]
        return -float(there[-1]) if there.size else float("nan")

    @property
    def peak_acceleration(self) -> float:
        """The largest magnitude of `acceleration` at the samples [m/s^2, rad/s^2]."""
        there = np.abs(self.acceleration[np.isfinite(self.acceleration)])
        return float(there.max()) if there.size else float("nan")

    @property
    def turns(self) -> bool:
        """Whether the body is followed by its angle."""
        return self.axis in ROTATIONS

    @property
    def position_label(self) -> str:
        """For an axis, with unit."""
        return f"{self.body} {f'angle about {self.axis[-1]} [deg]' if self.turns else f'{self.axis} [mm]'}".strip()

    @property
    def velocity_label(self) -> str:
        """For an axis, with unit."""
        what = f"angular velocity about {self.axis[-1]} [rad/s]" if self.turns else f"{self.axis} velocity [m/s]"
        return f"{self.body} {what}".strip()

    @property
    def acceleration_label(self) -> str:
        """For an axis, with unit."""
        turning = f"angular acceleration about {self.axis[-1]} [rad/s$^2$]"
        return f"{self.body} {turning if self.turns else f'{self.axis} acceleration [m/s$^2$]'}".strip()

    @property
    def position_factor(self) -> float:
        """To the unit of `position_label`."""
        return 180.0 / np.pi if self.turns else 1e3


def check_axis(axis: str | None) -> None:
    """Raise an error for an axis that is none of `AXES` and `ROTATIONS`; None stands for that of the motion."""
    if axis not in (None, *AXES, *ROTATIONS):
        raise SceneError(f"axis = {axis!r} is none of {', '.join((*AXES, *ROTATIONS))}")


def kind_of_model(model: AbstractSphericalModel | None) -> str:
    """Ideal, dry, friction, lubricated or bushing; empty for a model that is none of these."""
    if model is None or isinstance(model, Ideal):
        return "ideal"
    if isinstance(model, Dry):
        return "dry" if model.friction is None else "friction"
    return "lubricated" if isinstance(model, Lubricated) else "bushing" if isinstance(model, Bushing) else ""


def axis_of_motion(run: Trajectory, body: str) -> str:
    """The axis that shows the motion of a body best.

    Args:
        run: a single run, on the host.
        body: the body.

    Returns:
        The world axis along which its center of mass moves farthest; of a body that turns in one place the world axis
        about which it turns farthest.
    """
    center = np.asarray(run.position(body))
    center = center[np.isfinite(center).all(axis=1)]
    ranges = np.ptp(center, axis=0)
    part = run.system.bodies[body]
    gyration = np.sqrt(np.max(np.abs(np.asarray(part.inertia))) / float(part.mass))
    angles = [np.ptp(angle[np.isfinite(angle)]) for angle in (_angle(run, body, axis) for axis in range(3))]
    if np.max(ranges) < HARDLY_MOVES * gyration * np.max(angles):
        return ROTATIONS[int(np.argmax(angles))]
    return AXES[int(np.argmax(ranges))]


def _angle(run: Trajectory, body: str, axis: int) -> np.ndarray:
    """How far a body has turned about a world axis since the start [rad]: the integral of its angular velocity."""
    rate = np.asarray(run.angular_velocity(body))[:, axis]
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(np.asarray(run.ts))
    return np.concatenate([np.zeros(1), np.cumsum(steps)])


def curves_of(run: Trajectory, label: str, *, body: str, joint: str, axis: str | None = None) -> Curves:
    """The curves of a run that the figures of one mechanism draw.

    Args:
        run: a single run, on the host.
        label: what the legend shall say.
        body: the body whose motion is drawn.
        joint: the joint whose eccentricity is drawn: a spherical one, or a journal in its bearing.

    Other args:
        axis: along which world axis, `"x"`, `"y"` or `"z"`, or about which one, `"rotation.x"` and so on; that of the
            largest motion when None. Runs that are compared need the same one.

    Returns:
        Arrays of the host; samples behind the end of a run that failed are NaN, and drawn as a gap.

    Raises:
        SceneError: for lanes, an unknown name, or a joint that has no eccentricity.
    """
    if np.ndim(run.ys) != 2:
        raise SceneError("curves are those of a single run; take one lane: jax.tree.map(lambda x: x[0], runs)")
    placed: Any = run.system.joints.get(joint)
    model = getattr(placed, "model", None)
    # The two points of an ideal revolute joint stay together, but the equations have no name for their distance.
    is_kept = isinstance(placed, PlacedPair) and placed.coincides
    eccentricity = np.zeros((len(run.ts), 3)) if is_kept else np.asarray(run.eccentricity(joint))
    check_axis(axis)
    axis = axis_of_motion(run, body) if axis is None else axis
    at = "xyz".index(axis[-1])
    if axis in ROTATIONS:
        position = _angle(run, body, at)
        velocity, acceleration = run.angular_velocity(body), run.angular_acceleration(body)
    else:
        position = np.asarray(run.position(body)[:, at])
        velocity, acceleration = run.velocity(body), run.acceleration(body)
    clearance = getattr(model, "clearance", None)
    sliding = None
    if clearance is not None and getattr(model, "friction", None) is not None:
        sliding = np.linalg.norm(np.asarray(run.part(joint, "sliding_velocity")), axis=1)
    energy = np.asarray(run.mechanical_energy)
    return Curves(
        label=label,
        ts=np.asarray(run.ts),
        position=position,
        velocity=np.asarray(velocity[:, at]),
        acceleration=np.asarray(acceleration[:, at]),
        energy_change=energy - energy[0],
        eccentricity=eccentricity,
        sliding_speed=sliding,
        clearance=None if clearance is None else float(clearance),
        body=body,
        axis=axis,
        kind=kind_of_model(model),
        supplied=np.asarray(run.supplied_work) if run.system.tracks_supply else None,
        penetration=None if clearance is None else np.asarray(run.penetration(joint)),
    )


def thinned(ts: np.ndarray, values: np.ndarray, n_bins: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and the highest sample of every bin of time, in order.

    A history of 2e5 samples on 1500 pixels: every peak is still drawn, and the file stays small. Taking every
    hundredth sample instead would lose impacts, which last for less than a hundredth of a pixel.

    Args:
        ts: times [s], shape (n,).
        values: shape (n,).
        n_bins: number of bins; a history that is shorter than two samples a bin is returned whole.
    """
    size = len(ts) // n_bins
    if size <= 2:
        return ts, values
    n_bins = len(ts) // size
    n_full = size * n_bins
    blocks = values[:n_full].reshape(n_bins, size)
    # argmin of a block with NaN is the NaN's place: a failed run stays visible as a gap.
    chosen = np.sort(np.stack([blocks.argmin(1), blocks.argmax(1)], 1), axis=1) + size * np.arange(n_bins)[:, None]
    indices = np.unique(np.concatenate([chosen.ravel(), np.arange(n_full, len(ts))]))
    return ts[indices], values[indices]
