"""What a study of wear with a motion that follows returns."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.model.scene import Scene
from spherejax.motion.results.trajectory import Trajectory
from spherejax.physics.laws.depth import AbstractDepth, LegendreFourierDepth
from spherejax.studies.wear.wear_result import SIDES, Wear

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class WearBlock(NamedTuple):
    """What is told at the end of a block of cycles; the first one is the joint as it is described.

    Attributes:
        socket: coefficients of the socket's profile that the motion feels, as of `HarmonicDepth` or of a journal's
            `FourierDepth` [m]; of a journal that tilts a row for each plane; None: round.
        ball: those of the ball.
        misfit: root mean square over the contacts, by their rubbing work, of how much farther the ball goes on the maps
            than on the profiles [m].
        error: largest difference of the depths from those without a corrector, over the deepest wear.
        impulse: of the normal force in a cycle [N s].
        slid: integral of F_n |v_s| dt in the contacts' middles in a cycle [J].
    """

    socket: Float[np.ndarray, "*planes k"] | None
    ball: Float[np.ndarray, "*planes k"] | None
    misfit: float
    error: float
    impulse: float
    slid: float


@dataclass(frozen=True)
class WearIn:
    """Wear of a joint with a motion that follows the worn surfaces; prints as text.

    Attributes:
        wear: maps, volumes and depths along the cycles, as of `sj.wear`; its checks are of the first cycle.
        blocks: what is told of the motion and of the profiles, at each of `cycles`.
        degree: L of the profiles.
        scene: the scene with worn surfaces.
        run: of that scene.
    """

    wear: Wear
    blocks: tuple[WearBlock, ...]
    degree: int
    scene: Scene
    run: Trajectory

    @property
    def succeeded(self) -> bool:
        """Whether all cycles were reached."""
        return self.wear.succeeded

    @property
    def diagnosis(self) -> str:
        """Why not all cycles were reached; empty where they were."""
        return self.wear.diagnosis

    @property
    def cycles(self) -> Float[np.ndarray, " b"]:
        """Numbers of cycles after which the wear is told."""
        return self.wear.cycles

    def volumes(self, side: str) -> Float[np.ndarray, " b"]:
        """What was rubbed off `"socket"` or `"ball"` until each of `cycles` [m^3]."""
        return self.wear.volumes(side)

    def deepest(self, side: str) -> Float[np.ndarray, " b"]:
        """Largest depth at each of `cycles` [m]."""
        return self.wear.deepest(side)

    def depth(self, side: str, block: int = -1) -> Float[np.ndarray, "*shape"]:
        """Depth of wear of each cell [m]; after all cycles where no block is given."""
        return self.wear.depth(side, block)

    @property
    def misfit(self) -> Float[np.ndarray, " b"]:
        """How far the profiles are off in the contacts, at each of `cycles` [m]; see `WearBlock`."""
        return np.array([block.misfit for block in self.blocks])

    @property
    def error(self) -> Float[np.ndarray, " b"]:
        """Estimated error of each block, over the deepest wear; of the method without a corrector, so it is too
        large."""
        return np.array([block.error for block in self.blocks])

    def profile(self, side: str, block: int = -1) -> AbstractDepth | LegendreFourierDepth | None:
        """The depth of a side that the motion feels; None where it is round.

        Of a journal that tilts it is that of its planes, and between them of the polynomial through them.
        """
        coefficients = self.blocks[block].socket if side == "socket" else self.blocks[block].ball
        self.wear.depth(side)  # answers a side that is none
        return None if coefficients is None else self.wear.chart.profile(coefficients)

    def lost_volume(self, side: str) -> float:
        """By how much the mean of the last profile differs from the mean of the map, as a share of that.

        Profiles follow how far the ball goes, which the walls of a pocket hold up: they need not hold its volume.
        """
        profile = self.profile(side)
        chart = self.wear.chart
        mean = chart.total(self.depth(side)) / chart.total(np.ones(chart.shape))
        return 0.0 if profile is None or mean == 0 else float(profile.mean) / mean - 1.0

    def to_xarray(self) -> "xarray.Dataset":
        """As of `sj.wear`, with misfits, errors, impulses and profiles along the cycles."""
        data = self.wear.to_xarray()
        for name, unit, what in (
            ("misfit", "m", "root mean square of the profiles' error in the contacts"),
            ("error", "1", "estimated error of the block over the deepest wear"),
            ("impulse", "N s", "impulse of the normal force in a cycle"),
            ("slid", "J", "sliding work over the coefficient of friction, in a cycle"),
        ):
            values = np.array([getattr(block, name) for block in self.blocks])
            data[name] = ("cycle",), values, {"units": unit, "long_name": what}
        size = self.wear.chart.harmonics(self.wear.chart.centers[:1], self.degree).shape[1]
        for side in SIDES:
            rows = [getattr(block, side) for block in self.blocks]
            shape = (*self.wear.chart.shape[:-1], size) if self.wear.is_axial else (size,)
            values = np.stack([np.zeros(shape) if row is None else row for row in rows])
            what = f"harmonics of the {side}'s depth that the motion feels"
            dims = ("cycle", "plane", "harmonic") if self.wear.is_axial else ("cycle", "harmonic")
            data[f"{side}_profile"] = dims, values, {"units": "m", "long_name": what}
        return data

    def save(self, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
        """Write the data set: everything to netCDF (.nc), or a row for each of `cycles` to a table (.csv).

        Raises:
            SceneError: for another suffix, or a file that exists, unless `overwrite`.
        """
        from spherejax.output.io import save

        return save(self.to_xarray(), path, overwrite=overwrite)

    def figure(self) -> "Figure":
        """The maps, and volumes and depths along the cycles, as of `sj.wear`."""
        return self.wear.figure()

    def __str__(self) -> str:
        first, last = self.blocks[0], self.blocks[-1]
        text = str(self.wear).split("\n")
        lines = [
            f"motion of the worn joint: impulse of the normal force {first.impulse:.4g} N s in the first cycle, "
            f"{last.impulse:.4g} N s in the last one; sliding {first.slid:.4g} J and {last.slid:.4g} J",
            f"profiles of degree {self.degree}, off by {last.misfit:.2g} m in the contacts; error of a block at most "
            f"{100 * self.error.max():.2g} % of the deepest wear",
        ]
        at = len(text) - len(self.wear.remarks)
        return "\n".join([*text[:at], *lines, *text[at:]])
