"""What the figures of one mechanism draw: the histories of a body and of a joint, as plain host arrays.

A trajectory observes everything; a figure needs a few curves of it. Drawing code sees only `Curves`, so it
can be used with results that come from elsewhere, and a long study does not hold on to whole trajectories.
"""

from dataclasses import dataclass

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.motion.results.trajectory import Trajectory


@dataclass(frozen=True)
class Curves:
    """The vertical motion of a body, the energy, and the eccentricity of a joint.

    Attributes:
        label: what the legend says.
        ts: sample times [s], shape (n,).
        position: z of the body's center of mass [m], shape (n,).
        velocity: its rate [m/s], shape (n,).
        acceleration: its second rate [m/s^2], shape (n,).
        energy_change: mechanical energy minus that at the start [J], shape (n,).
        eccentricity: socket center to ball center, world axes [m], shape (n, 3).
        sliding_speed: of the contact points [m/s], shape (n,); None for a joint without friction.
        clearance: radial clearance of the joint [m]; None for a joint without clearance.
        body: whose motion it is; figures name it on their axes.
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

    @property
    def distance(self) -> np.ndarray:
        """|e| [m], shape (n,)."""
        return np.linalg.norm(self.eccentricity, axis=1)


def curves_of(run: Trajectory, label: str, *, body: str, joint: str) -> Curves:
    """The curves of a run that the figures of one mechanism draw.

    Args:
        run: a single run, on the host.
        label: what the legend shall say.
        body: the body whose vertical motion is drawn.
        joint: the spherical joint whose eccentricity is drawn.

    Returns:
        Arrays of the host; samples behind the end of a run that failed are NaN, and drawn as a gap.

    Raises:
        SceneError: for lanes, an unknown name, or a joint that is not spherical.
    """
    if np.ndim(run.ys) != 2:
        raise SceneError("curves are those of a single run; take one lane: jax.tree.map(lambda x: x[0], runs)")
    eccentricity = np.asarray(run.eccentricity(joint))
    model = getattr(run.system.joints[joint], "model", None)
    clearance = getattr(model, "clearance", None)
    sliding = None
    if clearance is not None and getattr(model, "friction", None) is not None:
        sliding = np.linalg.norm(np.asarray(run.part(joint, "sliding_velocity")), axis=1)
    energy = np.asarray(run.mechanical_energy)
    return Curves(
        label=label,
        ts=np.asarray(run.ts),
        position=np.asarray(run.position(body)[:, 2]),
        velocity=np.asarray(run.velocity(body)[:, 2]),
        acceleration=np.asarray(run.acceleration(body)[:, 2]),
        energy_change=energy - energy[0],
        eccentricity=eccentricity,
        sliding_speed=sliding,
        clearance=None if clearance is None else float(clearance),
        body=body,
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
