"""What a study of wear returns: maps of depth, volumes along the cycles, and what was checked."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.foundations.errors import SceneError
from spherejax.motion.results.dataset import AXES
from spherejax.studies.wear.charts import AbstractChart, AxialChart, CircleChart
from spherejax.studies.wear.cycles import Worn

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

SIDES = ("socket", "ball")


class WearWarning(UserWarning):
    """Something that should be known of a computed wear: what it is known to, or where it ends."""


class Checks(NamedTuple):
    """What was checked of the first cycle.

    Attributes:
        lost: rubbing work that is missing on a map, as a share.
        unbalanced: largest difference of the pressure's resultant from the normal force, as a share.
        slid: integral of F_n |v_s| dt, with the sliding velocity in the middle of each contact [J].
        rubbed: integral of p |v_s| dA dt over the patches [J]: `slid` for small ones; a wide patch presses with more
            than its resultant, and a ball that spins rubs although its middle rests.
        time_error: of the integrals over time, as a share of `slid`.
        gathering: share of the rubbing work that lies in other cells if instants are gathered in bins twice as wide.
        cells_per_patch: from the middle of a typical patch to its edge.
        instants: of contact in the steps of the run.
        gathered: patches that stand for them, see `spherejax.studies.wear.gathering`.
    """

    lost: float
    unbalanced: float
    slid: float
    rubbed: float
    time_error: float
    gathering: float
    cells_per_patch: float
    instants: int
    gathered: int


@dataclass(frozen=True)
class Wear:
    """Wear of a joint; prints as text. Of a journal "socket" is the bearing's side, and "ball" the journal's.

    Attributes:
        joint: its name.
        bodies: names of the socket's and the ball's body.
        coefficients: k of the socket's and the ball's material [m^2/N].
        clearance: c of the unworn joint [m].
        radius: R of the socket [m].
        chart: of the maps.
        area: of what a chart lays out as its unit [m^2]: R^2 of a ball, R L of a journal, and of all its planes.
        axes: of the maps of both sides in those of their bodies, as columns: a journal's z is along its axis.
        span: first and last instant of the cycle [s].
        states: of wear, after each block of cycles.
        checks: what was checked of the first cycle.
        diagnosis: why not all cycles were reached; empty where they were.
        remarks: what else should be known.
    """

    joint: str
    bodies: tuple[str, str]
    coefficients: tuple[float, float]
    clearance: float
    radius: float
    chart: AbstractChart
    area: float
    axes: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]
    span: tuple[float, float]
    states: tuple[Worn, ...]
    checks: Checks
    diagnosis: str
    remarks: tuple[str, ...]

    @property
    def succeeded(self) -> bool:
        """Whether all cycles were reached."""
        return not self.diagnosis

    @property
    def cycles(self) -> Float[np.ndarray, " b"]:
        """Numbers of cycles after which the wear is told."""
        return np.array([state.cycles for state in self.states])

    @property
    def cells(self) -> int:
        """n, of a map along each side, or around a bearing."""
        return self.chart.n

    def called(self, side: str) -> str:
        """What a side is: "socket" or "ball", "bearing" or "journal"."""
        names = SIDES if self.chart.is_ball else ("bearing", "journal")
        return names[_number(side)]

    @property
    def cell_area(self) -> float | Float[np.ndarray, "planes 1"]:
        """[m^2]; of a journal that tilts by plane."""
        return self.area * (self.chart.cell_shares if self.is_axial else self.chart.share)

    @property
    def is_axial(self) -> bool:
        """Whether it is of a journal that tilts, and has a map for each plane along the axis."""
        return isinstance(self.chart, AxialChart)

    @property
    def length(self) -> float | None:
        """Of the bearing [m]; None of a ball."""
        return None if self.chart.is_ball else self.area / self.radius

    @property
    def along(self) -> Float[np.ndarray, " planes"] | None:
        """Places of the planes of a journal that tilts along the axis, from the middle of its bearing [m], or None."""
        return 0.5 * self.area / self.radius * self.chart.places if isinstance(self.chart, AxialChart) else None

    def depth(self, side: str, block: int = -1) -> Float[np.ndarray, "*shape"]:
        """Depth of wear of each cell [m], shape (n, n), or (n,) around a bearing; (planes, n) where the journal tilts.

        Args:
            side: "socket" or "ball".
            block: number of the state; the last one where it is not given.

        Raises:
            SceneError: for another side.
        """
        return np.asarray(self.states[block].depth[_number(side)]).reshape(self.chart.shape)

    @property
    def directions(self) -> Float[np.ndarray, "*shape 3"]:
        """Unit vectors to the cells: from the socket's center in axes of its body, from the ball's in those of its.

        Around a bearing in the joint's axes, with z along it; `axes` has those of both bodies.
        """
        return self.chart.centers.reshape(*self.chart.shape, 3)

    def depth_at(
        self, side: str, u: Float[np.ndarray, "q 3"], block: int = -1, *, along: float | None = None
    ) -> Float[np.ndarray, " q"]:
        """Depth of wear at unit vectors in the axes of the side's body [m], interpolated between the cells.

        Around a bearing the part of the vectors across its axis counts.

        Args:
            side: "socket" or "ball".
            u: unit vectors.
            block: number of the state; the last one where it is not given.
            along: of a journal that tilts the place along its axis, from the middle of the bearing [m]; between the
                planes by the polynomial through them. Left out for others.

        Raises:
            SceneError: for another side, and for a place that is missing, beyond the bearing, or not asked for.
        """
        u = np.asarray(u, float) @ self.axes[_number(side)]
        u = u / np.linalg.norm(u, axis=-1, keepdims=True)
        chart, values = self._ring_at(np.asarray(self.depth(side, block)), along)
        found = chart.sampled(values.ravel(), u.reshape(-1, 3))
        return np.asarray(found).reshape(u.shape[:-1])

    def _ring_at(self, values: np.ndarray, along: float | None) -> tuple[AbstractChart, np.ndarray]:
        if not isinstance(self.chart, AxialChart):
            if along is not None:
                raise SceneError(f"wear of joint {self.joint!r}: it is the same along the axis; leave along= out")
            return self.chart, values
        half = 0.5 * self.area / self.radius
        if along is None or not abs(along) <= half * (1 + 1e-9):
            raise SceneError(
                f"wear of joint {self.joint!r}: along = {along!r} must be a place along the axis from {-half:.6g} to "
                f"{half:.6g} m; its planes are at {', '.join(f'{half * place:.6g}' for place in self.chart.places)} m"
            )
        return CircleChart(self.chart.n), self.chart.at(values, along / half)

    def volumes(self, side: str) -> Float[np.ndarray, " b"]:
        """What was rubbed off until each of `cycles` [m^3]."""
        return self._of_all(side, self.chart.total) * self.area

    def deepest(self, side: str) -> Float[np.ndarray, " b"]:
        """Largest depth at each of `cycles` [m]."""
        return self._of_all(side, np.max)

    def _of_all(self, side: str, measure) -> np.ndarray:
        number = _number(side)
        return np.array([float(measure(np.asarray(state.depth[number]))) for state in self.states])

    @property
    def volume_per_cycle(self) -> dict[str, float]:
        """What the first cycle rubs off each side [m^3]."""
        return {s: self.chart.total(self.states[0].rate.depth[_number(s)]) * self.area for s in SIDES}

    def depth_per_cycle(self, side: str, block: int = 0) -> Float[np.ndarray, "*shape"]:
        """What a cycle deepens each cell by [m]; of the first cycle where no block is given."""
        return np.asarray(self.states[block].rate.depth[_number(side)]).reshape(self.chart.shape)

    @property
    def effective_clearance(self) -> Float[np.ndarray, " b"]:
        """Clearance of an unworn joint in which the ball goes as far for the same load, the mean over the work [m]."""
        return self.clearance + np.array([state.rate.approach for state in self.states])

    @property
    def aside(self) -> Float[np.ndarray, " b"]:
        """Resultant of the pressure across the contact's direction over the normal force, the mean over the work."""
        return np.array([state.rate.aside for state in self.states])

    def to_xarray(self) -> "xarray.Dataset":
        """Maps, and volumes and depths along the cycles, with units."""
        import xarray

        columns = {}
        for name, values, unit, what in (
            ("volume", self.volumes, "m^3", "rubbed off"),
            ("deepest", self.deepest, "m", "largest depth of wear"),
        ):
            columns[name] = ("cycle", "side"), np.stack([values(s) for s in SIDES], axis=1), _words(unit, what)
        columns["effective_clearance"] = (
            ("cycle",), self.effective_clearance, _words("m", "clearance of an unworn joint that gives way as far")
        )  # fmt: skip
        columns["aside"] = ("cycle",), self.aside, _words("1", "unbalanced resultant across, over the normal force")
        places = ("row", "column") if self.chart.is_ball else ("plane", "around") if self.is_axial else ("around",)
        on_map = "side", *places
        depths = np.stack([self.depth(s) for s in SIDES])
        columns["depth"] = on_map, depths, _words("m", "depth of wear after all cycles")
        rates = np.stack([self.depth_per_cycle(s) for s in SIDES])
        columns["depth_per_cycle"] = on_map, rates, _words("m", "depth of wear of the first cycle")
        columns["direction"] = (
            (*places, "axis"), self.directions, _words("1", f"unit vector to the cell, axes of the {self._whose}")
        )  # fmt: skip
        coordinates = {
            "cycle": ("cycle", self.cycles, _words("1", "number of cycles")),
            "side": list(SIDES),
            "body": ("side", list(self.bodies)),
            "k": ("side", np.array(self.coefficients), _words("m^2/N", "wear coefficient")),
            **{place: np.arange(count) for place, count in zip(places, self.chart.shape, strict=True)},
            "axis": list(AXES),
        }
        if self.along is not None:
            columns["along"] = ("plane",), self.along, _words("m", "place of the plane from the middle of the bearing")
            columns["cell_area"] = ("plane",), np.ravel(self.cell_area), _words("m^2", "area of a cell of the plane")
        attributes = {
            "joint": self.joint,
            "clearance": self.clearance,
            "socket_radius": self.radius,
            "cycle_begins": self.span[0],
            "cycle_ends": self.span[1],
            **({} if self.is_axial else {"cell_area": self.cell_area}),
            **{f"check_{name}": value for name, value in self.checks._asdict().items()},
            "remarks": " ".join(self.remarks) or "none",
        }
        return xarray.Dataset(columns, coordinates, attributes)

    @property
    def _whose(self) -> str:
        return "side's body" if self.chart.is_ball else "joint"

    def save(self, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
        """Write the data set: everything to netCDF (.nc), or a row for each of `cycles` to a table (.csv).

        Raises:
            SceneError: for another suffix, or a file that exists, unless `overwrite`.
        """
        from spherejax.output.io import save

        return save(self.to_xarray(), path, overwrite=overwrite)

    def figure(self) -> "Figure":
        """The maps of both bodies, of equal area, seen at where they are worn; volumes and depths along the cycles."""
        return _figure_of(self)

    def __str__(self) -> str:
        return _text_of(self)


def _number(side: str) -> int:
    if side not in SIDES:
        raise SceneError(f"wear has the sides 'socket' and 'ball', and not {side!r}")
    return SIDES.index(side)


def _words(unit: str, what: str) -> dict[str, str]:
    return {"units": unit, "long_name": what}


def _text_of(worn: Wear) -> str:
    checks, until = worn.checks, worn.cycles[-1]
    lines = [
        f"Wear of joint {worn.joint} in {until:.6g} cycles of {worn.span[1] - worn.span[0]:.4g} s, "
        f"{len(worn.states) - 1} blocks, maps of {' x '.join(str(n) for n in worn.chart.shape)} cells"
    ]
    for side, body, k in zip(SIDES, worn.bodies, worn.coefficients, strict=True):
        lines.append(
            f"{worn.called(side)} ({body}, k = {k:.3g} m^2/N): {worn.volumes(side)[-1]:.4g} m^3 rubbed off, "
            f"{worn.deepest(side)[-1]:.4g} m deep; the first cycle {worn.volume_per_cycle[side]:.4g} m^3"
        )
    if worn.along is not None:
        side = max(SIDES, key=lambda s: worn.deepest(s)[-1])
        deepest = ", ".join(f"{depth:.3g}" for depth in worn.depth(side).max(axis=1))
        places = ", ".join(f"{1e3 * place:.3g}" for place in worn.along)
        lines.append(f"along the axis, at {places} mm from the middle of the bearing: {deepest} m deep")
    lines.append(
        f"effective clearance {worn.effective_clearance[-1]:.4g} m, at first {worn.clearance:.4g} m; force across the "
        f"contacts' directions {100 * worn.aside[-1]:.2g} % of the normal one"
    )
    lines.append(
        f"a cycle's sliding {checks.slid:.4g} J (to {100 * checks.time_error:.1g} %), over the patches "
        f"{checks.rubbed:.4g} J, all on the maps; {100 * checks.gathering:.2g} % of it lies elsewhere if alike "
        f"instants are gathered more coarsely; a patch is {checks.cells_per_patch:.2g} cells from "
        "middle to edge"
    )
    return "\n".join(lines + [f"warning: {text}" for text in worn.remarks])


def _figure_of(worn: Wear) -> "Figure":
    from spherejax.output.plot.wear import WearMap, WearRing, wear_figure

    maps: list[WearMap | WearRing] = []
    for side, body in zip(SIDES, worn.bodies, strict=True):
        if not worn.chart.is_ball:
            directions = worn.directions.reshape(-1, worn.cells, 3)[0]
            angles = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
            order, name = np.argsort(angles), worn.called(side)
            depths = 1e6 * worn.depth(side).reshape(-1, worn.cells)[:, order]
            planes = () if worn.along is None else tuple(f"{1e3 * place + 0.0:.3g} mm" for place in worn.along)
            along = 1e9 * worn.volumes(side), 1e6 * worn.deepest(side)
            maps.append(WearRing(f"{name}, body {body!r}", angles[order], depths, *along, planes))
            continue
        maps.append(
            WearMap(
                f"{side}, body {body!r}",
                lambda u, side=side: 1e6 * worn.depth_at(side, u),
                worn.directions.reshape(-1, 3),
                1e6 * worn.depth(side).ravel(),
                1e9 * worn.volumes(side),
                1e6 * worn.deepest(side),
            )
        )
    title = f"Wear of joint {worn.joint} in {worn.cycles[-1]:.4g} cycles"
    return wear_figure(maps, worn.cycles, title)
