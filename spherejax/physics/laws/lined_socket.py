"""The film of a ball in a cup with an elastic liner: Reynolds' equation and the liner's deflection together.

The liner gives way at each place by the pressure there alone, as a foundation of columns, p = k_w w. In axes of the
socket Reynolds' equation is the balance of volume

    dw/dt = (e_rate - w_s x e).u - div q,    q = h U - h**3/(12 eta) grad p,    h = c - e.u + w

at the place u (outward, unit), with U = (w_b - w_s) x R u/2, half the speed of the ball's surface against the socket's.
The deflections are states, and no pressure is left to be solved for.

The cup is divided into cells by circles of latitude and by meridians about its axis. Through a face with the corners a
and b U carries S = R**2 (w_b - w_s).(b - a)/2 per thickness, exactly. With this S the flow through a face is

    S H - G (w_down - w_up) H**3

by a thickness H of the gap there. Where cells resolve the gap, H is that halfway between both. The rigid gap bends
on this way: at |e| = 0.95 c the mean of both is wider by a sixth to a third under the load, with 6 x 12 cells. So H
has the rigid gap of the place itself, but where the ball is pressed in: there the deflection bends against the gap, and
the mean is the film.

At the edge of a loaded contact cells do not resolve the gap: the inlet, where it narrows from micrometers to a thin
film, is a hundredth of the radius wide. There the film obeys a kinematic wave equation with the pressure of nearly dry
contact, and H is Godunov's: that upstream, but against the pressure no more than what gives the largest flow,

    h* = (S/(3 G (w_down - w_up)))**(1/2)

so the inlet lets through 2/3 S h*, whatever stands before it. One equation serves from a concentric ball to one that
is pressed in by several clearances.

Source: derived here; the flow through faces: Godunov (1959), Mat. Sb. 47:271-306.
"""

from typing import Annotated, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Matrix3, Number, Scalar, Triple, Unit, Vector3
from spherejax.physics.bodies import numbers
from spherejax.physics.laws.conformity import WinklerLiner
from spherejax.physics.laws.films import AbstractFilm, FilmAction, FilmGap, FilmMotion, FullFilm
from spherejax.physics.laws.full_film import PressurePeak, directions_across
from spherejax.physics.memory import MemoryEntry

FEWEST_RINGS, MOST_RINGS = 4, 24
FEWEST_AROUND, MOST_AROUND = 8, 48

WIDEST_COVER = 3.0
"""Of a cup [rad]. In a sphere without a rim the level of the pressure is not determined: oil can neither enter nor
leave."""

RESOLVED, UNRESOLVED = 0.5, 0.9
"""Change of the rigid gap from cell to cell over the sum of both thicknesses, up to which the thickness halfway serves
and from which on Godunov's does. Six times as much is the Peclet number of the thin film, whose waves run with
3 k_w |grad h_0| h**2/(12 eta) and spread with k_w h**3/(12 eta). Chosen among five pairs for loads beside a fine grid
(`benchmarks/lined_socket_cells.py`); with 0.6 and 1.0 noise of rounding grows while a film drains."""

FOLLOWED = 2.0
"""Halfway between cells the bend of the rigid gap counts in full where the rigid gap is more than one part in so many
of the thickness, and not where it is negative. Chosen with the pair above; with 1 loads about |e| = c are worse."""

THINNEST = 1e-4
"""Share of the clearance. Where the film would be thinner, columns press as dry ones."""

LEAST = 2e-4
"""Share of the clearance below which a run says that surfaces touch."""

FURTHEST = 0.1
"""|e| as a share of the radius up to which a run says nothing; the gap c - e.u is that of c, |e| << R."""

_AT_REST = 1e-30
"""Of what is carried through a face per thickness [m^2/s]: 1 rad/s and a radius of 1 mm carry 1e-7. Roots of it have a
derivative at rest so."""


class _Grid(NamedTuple):
    """Cells of a cup, axes of the cup, its axis along z.

    Attributes:
        places: unit vectors to the cells.
        corners: to the corners, each between its meridian and the next one.
        rim: to the rim.
        areas: of the cells [sr].
        outward: width over distance of the faces to the next ring [-].
        onward: that of the faces to the next meridian [-].
        outer_halfway: unit vectors halfway to the next ring, the rim behind the last one.
        onward_halfway: and to the next meridian.
    """

    places: Float[Array, "rings around 3"]
    corners: Float[Array, "edges around 3"]
    rim: Float[Array, "around 3"]
    areas: Float[Array, "rings 1"]
    outward: Float[Array, "rings 1"]
    onward: Float[Array, "rings 1"]
    outer_halfway: Float[Array, "rings around 3"]
    onward_halfway: Float[Array, "rings around 3"]


class _Cells(NamedTuple):
    """Of a film, at its cells or at their neighbors.

    Attributes:
        deflection: of the liner where it is pressed [m].
        thickness: of the gap [m].
    """

    deflection: Float[Array, "rings around"]
    thickness: Float[Array, "rings around"]


class _Faces(NamedTuple):
    """Flow through the faces of one direction.

    Attributes:
        volume: flow [m^3/s].
        spread: part of it that the pressure drives [m^3/s].
        leak: flow by the difference of deflections with the thickness halfway [m^2/s].
        rigid: thickness of what is carried, less the mean deflection [m].
        drop: difference of deflections [m].
    """

    volume: Array
    spread: Array
    leak: Array
    rigid: Array
    drop: Array


class LinedSocket(AbstractFilm):
    """The film of a ball in a cup with an elastic liner, from light loads to soft elastohydrodynamic lubrication.

        A_i d/dt w_i = A_i (e_rate - w_s x e).u_i - sum of the flows through the faces of the cell i
        flow = S H - k_w/(12 eta) (width/distance) (w_down - w_up) H**3
        F = -k_w sum_i A_i w_i u_i

    w_i is the deflection of the liner, a foundation of columns with the k_w of `WinklerLiner`, S what the half of the
    surface speed carries through a face per thickness, and H a thickness of the gap there, see `lined_socket`. At the
    rim of the cup there is ambient pressure and as much oil as enters. With `Guembel` no pressure is negative, and its
    edge is where the flow has it (Reynolds' condition); with `Sommerfeld` suction draws the liner in.

    The film bears the ball beyond the clearance too: there is no dry contact beside it, and `e_h0`, `e_h1` and the
    normal law have no part. A film that would be thinner than `THINNEST` of the clearance presses as dry columns do.
    `"film_thickness"` is the least thickness; beside the roughness of the surfaces it says whether the film is whole.

    What the ball gives to the film is stored in the liner, k_w/2 sum A_i w_i**2, or dissipated, and neither of both
    dissipated powers is ever negative. The moment of the pressure on the ball is the derivative by the spin of what the
    carried oil takes, -e x F/2 on a fine grid; a pair keeps its angular momentum.

    Attributes:
        liner: its material and thickness.
        cover: angle from the axis of the cup to its rim [rad]; pi/2 for a hemisphere, at most 3.
        axis: from the center to the middle of the cup, in axes of the socket's body; of any length [-].
        rings: cells from the middle to the rim (static).
        around: cells round the axis, each with a state in each ring (static).

    Limits: a liner that is thin against the width of the pressure; c, |e| << R; one viscosity. Beside the same
        equation on a fine grid, 6 x 12 cells of a hemisphere bear loads within 5.4 % up to |e| = 0.9 c, within 17 % up
        to 1.1 c, where thin oil has pressure within less than a cell, and within 5 % beyond. The thickness in the cell
        under the load is within 8 % beyond c. The narrow exit of a contact that slides fast is missed: there the film
        may be half as thick as in any cell. A contact that reaches the rim, a film below 2e-4 of the clearance, and a
        ball further out than R/10 bring a warning (`OutOfRangeWarning`).

    Source: derived here; a ball in a cup of polyethylene, with its film, as in Jalali-Vahid et al. (2001), J. Biomech.
    34:261-266.
    """

    carries_contact: ClassVar[bool] = True
    beyond_range: ClassVar[str] = (
        "on a LinedSocket the film was thinner than 2e-4 of the clearance, or the ball was pressed against the rim of "
        "the cup, where surfaces touch and columns count as dry and without friction, or the ball was further out than "
        "a tenth of its radius (a larger cover, a thicker oil, an axis along the load)"
    )

    liner: WinklerLiner
    cover: Annotated[Number, Unit("rad")]
    axis: Annotated[Triple, Unit("1")]
    rings: int = eqx.field(static=True)
    around: int = eqx.field(static=True)

    def __init__(
        self,
        liner: WinklerLiner,
        cover: Annotated[Number, Unit("rad")] = np.pi / 2,
        axis: Annotated[Triple, Unit("1")] = (0.0, 0.0, 1.0),
        rings: int = 6,
        around: int = 12,
    ):
        self.liner = liner
        self.cover = cover
        self.axis = numbers(axis)
        self.rings = rings
        self.around = around

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """The deflection of each cell, ring by ring from the middle."""
        return tuple(MemoryEntry(f"deflection_{i}", "m", "film") for i in range(self.rings * self.around))

    @property
    def stores_energy(self) -> bool:
        """The liner does."""
        return True

    def rigid(self) -> AbstractFilm:
        """`FullFilm`."""
        return FullFilm()

    def places(self, motion: FilmMotion) -> Float[Array, "rings around 3"]:
        """Unit vectors to the cells, world axes."""
        return self._grid().places @ self._frame(motion).T

    def action(self, motion: FilmMotion, gap: FilmGap) -> FilmAction:
        """Force and moments of the pressure that the liner bears, and the rates of its deflections."""
        frame, grid, cells = self._frame(motion), self._grid(), self._cells(motion, gap)
        rate = (motion.e_rate - jnp.cross(motion.socket_spin, motion.e)) @ frame
        spin = (motion.ball_spin - motion.socket_spin) @ frame
        outward, onward = self._faces(motion, gap, grid, cells, spin)
        radius, foundation, deflection = gap.socket_radius, self.liner.foundation(), cells.deflection
        leaving = _sum_at_cells(outward.volume, onward.volume, -1.0)
        if not gap.boundary.bears_suction:
            # An empty cell sinks until what its neighbors' pressure drives to it makes up for what it lacks.
            missing = jnp.minimum(self._arranged(motion), 0.0)
            leaving = leaving + _sum_at_cells(outward.leak, onward.leak, 1.0) * missing
        rates = grid.places @ rate - leaving / (radius**2 * grid.areas)
        pressed = foundation * radius**2 * grid.areas * deflection
        force = frame @ -_weighted(pressed, grid.places)
        rolling = 0.5 * radius**2 * foundation * _round_corners(outward, onward, grid)
        couple = self._shear(gap, grid, cells, spin)
        moment = frame @ (rolling + couple)
        spread = jnp.sum(outward.drop * outward.spread) + jnp.sum(onward.drop * onward.spread)
        return FilmAction(
            force,
            moment,
            -jnp.cross(motion.e, force) - moment,
            foundation * spread,
            -(couple @ spin),
            rates.ravel(),
            0.5 * jnp.sum(pressed * deflection),
        )

    def pressure_peak(self, motion: FilmMotion, gap: FilmGap) -> PressurePeak:
        """The largest pressure of all cells."""
        deflection = self._cells(motion, gap).deflection.ravel()
        highest = jnp.argmax(deflection)
        largest = jnp.maximum(deflection[highest], 0.0)
        place = self.places(motion).reshape(-1, 3)[highest]
        return PressurePeak(self.liner.foundation() * largest, jnp.where(largest > 0, 1.0, 0.0) * place)

    def thickness(self, motion: FilmMotion, gap: FilmGap) -> Scalar:
        """The least thickness of all cells [m]."""
        return jnp.min(self._cells(motion, gap).thickness)

    def range_share(self, motion: FilmMotion, gap: FilmGap) -> Scalar:
        """By the least thickness, the rim's included, and by |e|/R."""
        least = jnp.minimum(self.thickness(motion, gap), jnp.min(self._rim_thickness(motion, gap)))
        out = safe_norm(motion.e) / (FURTHEST * gap.socket_radius)
        return jnp.maximum(LEAST * gap.clearance / least, out)

    def requirements(self) -> list[Requirement]:
        """A liner, a cup with a rim and a direction, and numbers of cells."""
        cover, axis = numeric(self.cover), numeric(self.axis)
        square = (axis**2).sum()
        fits = (cover > 0) & (cover <= WIDEST_COVER)
        return [
            *(r._replace(field=f"liner.{r.field}") for r in self.liner.requirements()),
            Requirement(
                "cover", self.cover, fits, f"lie in (0, {WIDEST_COVER}] rad", "A hemisphere has pi/2; leave it out."
            ),
            Requirement(
                "axis",
                self.axis,
                (square > 0) & (square < np.inf),
                "be a direction in space",
                "Leave it out for (0, 0, 1).",
            ),
            _count("rings", self.rings, FEWEST_RINGS, MOST_RINGS, 6),
            _count("around", self.around, FEWEST_AROUND, MOST_AROUND, 12),
        ]

    def _grid(self) -> _Grid:
        """Cells of equal steps of both angles."""
        step, turn = self.cover / self.rings, 2.0 * np.pi / self.around
        edges, middles = step * np.arange(self.rings + 1), step * (np.arange(self.rings) + 0.5)
        around = turn * np.arange(self.around)
        # The rim is half a step from the last cells.
        distance = step * np.where(np.arange(self.rings) == self.rings - 1, 0.5, 1.0)[:, None]
        sine = jnp.sin(middles)[:, None]
        return _Grid(
            _directions(middles, around),
            _directions(edges, around + 0.5 * turn),
            _directions(edges[-1:], around)[0],
            2.0 * turn * jnp.sin(0.5 * step) * sine,
            turn * jnp.sin(edges[1:])[:, None] / distance,
            step / (turn * sine),
            _directions(middles + 0.5 * distance[:, 0], around),
            _directions(middles, around + 0.5 * turn),
        )

    def _frame(self, motion: FilmMotion) -> Matrix3:
        """Axes of the cup as columns, world axes; the last is its own."""
        assert motion.socket_axes is not None
        axis = jnp.asarray(self.axis)
        axis = axis / jnp.sqrt(axis @ axis)
        return motion.socket_axes @ jnp.stack([*directions_across(axis), axis], axis=1)

    def _eccentricity(self, motion: FilmMotion) -> Vector3:
        """e in axes of the cup."""
        return motion.e @ self._frame(motion)

    def _arranged(self, motion: FilmMotion) -> Float[Array, "rings around"]:
        """What is remembered, by rings."""
        assert motion.memory is not None
        return motion.memory.reshape(self.rings, self.around)

    def _cells(self, motion: FilmMotion, gap: FilmGap) -> _Cells:
        """Deflection where there is pressure, and the gap with it."""
        rigid = gap.clearance - self._grid().places @ self._eccentricity(motion)
        deflection = self._arranged(motion)
        if not gap.boundary.bears_suction:
            deflection = jnp.maximum(deflection, 0.0)
        deflection = jnp.maximum(deflection, THINNEST * gap.clearance - rigid)
        return _Cells(deflection, rigid + deflection)

    def _rim_thickness(self, motion: FilmMotion, gap: FilmGap) -> Float[Array, " around"]:
        rigid = gap.clearance - self._grid().rim @ self._eccentricity(motion)
        return jnp.maximum(rigid, THINNEST * gap.clearance)

    def _faces(
        self, motion: FilmMotion, gap: FilmGap, grid: _Grid, cells: _Cells, spin: Vector3
    ) -> tuple[_Faces, _Faces]:
        """Flow to the next ring, the rim behind the last one, and to the next meridian."""
        stream = 0.5 * gap.socket_radius**2 * (grid.corners @ spin)
        slope = self.liner.foundation() / (12.0 * gap.viscosity)
        deflection, thickness = cells
        rim = self._rim_thickness(motion, gap)[None]
        outer = _Cells(jnp.concatenate([deflection[1:], jnp.zeros_like(rim)]), jnp.concatenate([thickness[1:], rim]))
        onward = _Cells(jnp.roll(deflection, -1, axis=1), jnp.roll(thickness, -1, axis=1))
        e, thinnest = self._eccentricity(motion), THINNEST * gap.clearance

        def halfway(places: Array, there: _Cells) -> _Cells:
            rigid, mean = gap.clearance - places @ e, 0.5 * (thickness + there.thickness)
            pressed = 0.5 * (deflection + there.deflection)
            share = jnp.clip(FOLLOWED * rigid / mean, 0.0, 1.0)
            return _Cells(pressed, jnp.maximum(mean + share * (rigid + pressed - mean), thinnest))

        return (
            _flow(
                stream[1:] - jnp.roll(stream[1:], 1, axis=1),
                slope * grid.outward,
                cells,
                halfway(grid.outer_halfway, outer),
                outer,
            ),
            _flow(stream[:-1] - stream[1:], slope * grid.onward, cells, halfway(grid.onward_halfway, onward), onward),
        )

    def _shear(self, gap: FilmGap, grid: _Grid, cells: _Cells, spin: Vector3) -> Vector3:
        """Couple of the sheared oil on the ball, in a gap that is full [N m]."""
        braking = gap.viscosity * gap.socket_radius**4 * grid.areas / cells.thickness
        return _weighted(braking * (grid.places @ spin), grid.places) - jnp.sum(braking) * spin


def _flow(carried: Array, slope: Array, here: _Cells, halfway: _Cells, there: _Cells) -> _Faces:
    """Flow from cells to their neighbors.

    Args:
        carried: S, by the surface speed, per thickness [m^2/s].
        slope: G, by the difference of deflections, per thickness cubed [1/(m s)].
    """
    drop = here.deflection - there.deflection
    is_onward = carried >= 0
    speed, rise = jnp.abs(carried), slope * jnp.where(is_onward, -drop, drop)
    up = jnp.where(is_onward, here.thickness, there.thickness)
    down = jnp.where(is_onward, there.thickness, here.thickness)
    largest = jnp.maximum(3.0 * jnp.maximum(rise, 0.0) * up * up, speed)
    choked = jnp.maximum(up * jnp.sqrt((speed + _AT_REST) / (largest + _AT_REST)), down)
    unresolved = jnp.where(rise > 0, jnp.where(up > down, choked, halfway.thickness), up)
    step = jnp.abs(there.thickness - here.thickness + drop) / (up + down)
    share = jnp.clip((UNRESOLVED - step) / (UNRESOLVED - RESOLVED), 0.0, 1.0)
    thickness = share * halfway.thickness + (1.0 - share) * unresolved
    spread = slope * drop * (share * halfway.thickness**3 + (1.0 - share) * unresolved**3)
    rigid = thickness - halfway.deflection
    return _Faces(carried * thickness + spread, spread, slope * halfway.thickness**3, rigid, drop)


def _round_corners(outward: _Faces, onward: _Faces, grid: _Grid) -> Vector3:
    """Sum over the faces of drop times rigid thickness times (b - a) [m^2]: by the corners, each in four faces."""
    none = jnp.zeros((1, grid.corners.shape[1]))
    out, on = outward.drop * outward.rigid, onward.drop * onward.rigid
    at_corners = jnp.concatenate([none, out - jnp.roll(out, -1, axis=1)])
    at_corners = at_corners + jnp.concatenate([on, none]) - jnp.concatenate([none, on])
    return _weighted(at_corners, grid.corners)


def _sum_at_cells(outward: Array, onward: Array, sign: float) -> Array:
    """Of the faces of each cell, those behind it with a sign; through the middle of the cup nothing passes."""
    inner = jnp.concatenate([jnp.zeros_like(outward[:1]), outward[:-1]])
    return outward + sign * inner + onward + sign * jnp.roll(onward, 1, axis=1)


def _weighted(weights: Array, vectors: Array) -> Vector3:
    """Their sum."""
    return weights.ravel() @ vectors.reshape(-1, 3)


def _directions(polar: Array | np.ndarray, azimuth: np.ndarray) -> Float[Array, "polar azimuth 3"]:
    """Unit vectors by the angles from the axis and about it."""
    sine, cosine = jnp.sin(polar)[:, None], jnp.cos(polar)[:, None]
    return jnp.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine * np.ones_like(azimuth)], axis=-1)


def _count(field: str, value: int, fewest: int, most: int, default: int) -> Requirement:
    fits = isinstance(value, int) and fewest <= value <= most
    return Requirement(field, value, fits, f"be a whole number from {fewest} to {most}", f"Leave it out for {default}.")
