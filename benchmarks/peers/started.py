"""A scene at its assembled start, in plain NumPy: what every translator begins from."""

from typing import NamedTuple

import numpy as np

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix
from spherejax.model.system import System, compile_scene
from spherejax.physics.bodies import GROUND


class Pose(NamedTuple):
    """Where a body starts, and how it moves: world axes, SI."""

    position: np.ndarray
    quaternion: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray

    def point(self, place) -> np.ndarray:
        """A point given in body axes, in world axes."""
        return self.position + self.rotation @ np.asarray(place, float)

    def direction(self, vector) -> np.ndarray:
        """A direction given in body axes, in world axes."""
        return self.rotation @ np.asarray(vector, float)


class Start(NamedTuple):
    """The compiled scene and the poses of its bodies, the ground included."""

    system: System
    poses: dict[str, Pose]


def start_of(scene: sj.Scene) -> Start:
    """Assemble the start as `simulate` does."""
    run = sj.simulate(scene, ts=np.array([0.0, 1e-9]))
    still = np.zeros(3)
    poses = {GROUND: Pose(still, np.array([1.0, 0, 0, 0]), np.eye(3), still, still)}
    for name in run.system.bodies:
        quaternion = np.array(run.quaternion(name)[0])
        poses[name] = Pose(
            np.array(run.position(name)[0]),
            quaternion,
            np.array(rotation_matrix(quaternion)),
            np.array(run.velocity(name)[0]),
            np.array(run.angular_velocity(name)[0]),
        )
    return Start(compile_scene(scene).system, poses)


class NoCounterpartError(Exception):
    """The other simulator has no such element."""
