"""Modes of a linearized mechanism: eigenvalues, frequencies, damping, shapes, and their derivatives by any number."""

from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float

from spherejax.foundations.errors import SceneError
from spherejax.model.numbers import number_at
from spherejax.studies.linear.eigen import Eigen, eigen
from spherejax.studies.linear.following import slopes_of

if TYPE_CHECKING:
    import os
    from pathlib import Path

    import xarray
    from matplotlib.figure import Figure


REPEATED = 1e-6
"""Eigenvalues closer than this share of their size count as repeated: rounding splits a pair by about 1e-8."""

REAL = 1e-9
"""Imaginary parts below this share are rounding."""

SHOWN = 30
"""Rows of a table that is printed, at most."""

COMPONENTS = ("x", "y", "z", "turn_x", "turn_y", "turn_z")


class Slope(NamedTuple):
    """Derivatives of one mode by a number.

    Attributes:
        eigenvalue: of lambda [1/s per unit of the number].
        frequency: of the undamped frequency |lambda| / (2 pi) [Hz per unit].
        damping_ratio: of -Re lambda / |lambda| [1 per unit].
    """

    eigenvalue: complex
    frequency: float
    damping_ratio: float


class Modes:
    """Modes, sorted by frequency: an eigenvalue with Im >= 0 for each pair; zero ones are counted apart.

    Prints as a table. Shapes are of the deviation exp(lambda t), in world axes, mass-normalized: the displacements and
    rotations z of all bodies have z^H M z = 1, and the largest is real; a mode of memory alone has none.

    Attributes:
        linear: the `Linearization`.
        eigenvalues: lambda [1/s], shape (k,).
        n_zero: number of zero eigenvalues: two for each free motion that nothing resists, one for each direction in
            which a mechanism has neutral positions or a constant speed, and for what is remembered for ever.
        bodies: names.
        shapes: displacements [m] and rotations [rad] of the bodies, shape (k, n_bodies, 6).
        memory: of each shape, shape (k, m).
    """

    def __init__(self, linear: Any):
        self.linear = linear
        found = eigen(linear.A, linear.rounding)
        chosen, self.n_zero = _one_of_pairs(found), found.n_zero
        self._all, self._eigen = found.values, Eigen(found.n_zero, *(each[..., chosen] for each in found[1:]))
        self.eigenvalues: Complex[np.ndarray, " k"] = self._eigen.values
        layout = linear.point.system.layout
        moved = linear.basis @ self._eigen.right
        n_v = layout.n_velocity
        factors = np.array([_normalizing(z, linear.coordinates.mass) for z in moved[:n_v].T])
        moved = moved * factors.reshape(-1)
        self.bodies = tuple(linear.point.system.bodies)
        self.shapes: Complex[np.ndarray, "k b 6"] = moved[:n_v].T.reshape(-1, layout.n_bodies, 6)
        self.memory: Complex[np.ndarray, "k m"] = moved[2 * n_v :].T

    @property
    def frequency(self) -> Float[np.ndarray, " k"]:
        """Undamped natural frequency |lambda| / (2 pi) [Hz]."""
        return np.abs(self.eigenvalues) / (2 * np.pi)

    @property
    def damped_frequency(self) -> Float[np.ndarray, " k"]:
        """Frequency of the oscillation, Im lambda / (2 pi) [Hz]; zero of a mode that does not oscillate."""
        return np.imag(self.eigenvalues) / (2 * np.pi)

    @property
    def damping_ratio(self) -> Float[np.ndarray, " k"]:
        """-Re lambda / |lambda| [-]; 1 of a mode that dies away without oscillating, negative of one that grows."""
        return -np.real(self.eigenvalues) / np.abs(self.eigenvalues)

    @property
    def is_stable(self) -> bool:
        """Whether no mode grows; zero eigenvalues neither grow nor die."""
        return bool(np.all(np.real(self.eigenvalues) <= REAL * np.abs(self.eigenvalues)))

    def shape(self, mode: int, body: str) -> Complex[np.ndarray, " 6"]:
        """Displacement [m] of a body's center of mass and rotation [rad] in a mode, world axes."""
        if body not in self.bodies:
            raise SceneError(f"there is no body {body!r}; there are {', '.join(map(repr, self.bodies))}")
        return self.shapes[self._number(mode), self.bodies.index(body)]

    def __len__(self) -> int:
        return len(self.eigenvalues)

    # Derivatives -------------------------------------------------------------------------------------------------

    @cached_property
    def is_simple(self) -> Bool[np.ndarray, " k"]:
        """Whether each eigenvalue is apart from all others, so that it has a derivative."""
        distances = np.abs(self.eigenvalues[:, None] - self._all)
        near = np.sum(distances < REPEATED * np.abs(self.eigenvalues)[:, None], axis=1)
        return (near == 1) & (REPEATED * self._eigen.condition < 1)

    def eigenvalue_sensitivity(self, number: str) -> Complex[np.ndarray, " k"]:
        """Derivative of every eigenvalue by a number of the scene [1/s per unit of the number].

        d lambda / dp = w^H (dA/dp) v / (w^H v), with left and right vectors w and v. dA/dp is total: the start that is
        assembled and the rest position that is found move with the number, and so do the coordinates. About a moment
        of a run the state is held. Bodies must not move.

        Args:
            number: path, e.g. `"joints.elbow.model.stiffness"`, `"bodies.rocker.mass"`.

        Returns:
            One for each mode; NaN for repeated eigenvalues, whose derivatives depend on what else changes.

        Raises:
            SceneError: for a path that leads nowhere, a state with velocities, a number that moves the constraints
                away from a state of a run, or one that makes redundant constraints contradict each other.
        """
        slope = _slope_of_matrix(self.linear, number)
        values = np.einsum("ik,ij,jk->k", self._eigen.left.conj(), slope, self._eigen.right)
        return np.where(self.is_simple, values, np.nan)

    def sensitivity(self, mode: int, number: str) -> Slope:
        """Derivatives of one mode's eigenvalue, frequency and damping ratio by a number; see `eigenvalue_sensitivity`.

        Raises:
            SceneError: for a repeated eigenvalue, and as there.
        """
        k = self._number(mode)
        found = self.slopes(number)[k]
        if found is None:
            raise SceneError(
                f"mode {k} has a repeated eigenvalue ({_complex(self.eigenvalues[k])} 1/s), which has no derivative by "
                "one number alone; break the symmetry a little, or look at the sum of both"
            )
        return found

    def slopes(self, number: str) -> "list[Slope | None]":
        """As `sensitivity`, of every mode; None of repeated eigenvalues."""
        found: list[Slope | None] = []
        slopes = self.eigenvalue_sensitivity(number)
        for value, slope, simple in zip(self.eigenvalues, slopes, self.is_simple, strict=True):
            size = abs(value)
            growth = (value.conjugate() * slope).real / size
            damping = -slope.real / size + value.real * growth / size**2
            one = Slope(complex(slope), float(growth / (2 * np.pi)), float(damping))
            found.append(one if simple else None)
        return found

    def _number(self, mode: int) -> int:
        if not isinstance(mode, (int, np.integer)) or not 0 <= mode < len(self):
            raise SceneError(f"there is no mode {mode!r}; there are {len(self)}, counted from 0")
        return int(mode)

    # Output ------------------------------------------------------------------------------------------------------

    def to_xarray(self) -> "xarray.Dataset":
        """Eigenvalues, frequencies, damping ratios and shapes over `mode`, `body` and `component`, with units.

        Complex numbers have real and imaginary parts of their own: netCDF knows none.
        """
        import xarray

        def column(values, unit: str, words: str, dims=("mode",)):
            return dims, values, {"units": unit, "long_name": words}

        over = ("mode", "body", "component")
        return xarray.Dataset(
            {
                "eigenvalue_real": column(np.real(self.eigenvalues), "1/s", "growth rate"),
                "eigenvalue_imag": column(np.imag(self.eigenvalues), "rad/s", "damped angular frequency"),
                "frequency": column(self.frequency, "Hz", "undamped frequency"),
                "damping_ratio": column(self.damping_ratio, "1", "damping ratio"),
                "shape_real": column(np.real(self.shapes), "m or rad", "displacement and rotation, real part", over),
                "shape_imag": column(
                    np.imag(self.shapes), "m or rad", "displacement and rotation, imaginary part", over
                ),
            },
            {"mode": np.arange(len(self)), "body": list(self.bodies), "component": list(COMPONENTS)},
            {"n_zero_eigenvalues": self.n_zero, "state": self.linear.point.words},
        )

    def figure(self, modes: "int | list[int] | None" = None) -> "Figure":
        """The mechanism, displaced along its modes; see `sj.plot.modes`."""
        from spherejax.output.plot.modes import modes as drawn

        return drawn(self, modes)

    def animate(
        self,
        path: "str | os.PathLike",
        mode: int = 0,
        *,
        view: tuple[float, float] | None = None,
        reach: float = 0.14,
        fps: float = 25.0,
        overwrite: bool = False,
    ) -> "Path":
        """Write a swing of the mechanism in a mode as a film, two seconds long and without its damping.

        Shown again and again it swings on. One that does not oscillate is drawn there and back, and so said.

        Args:
            path: where to write, `.gif` or `.mp4`, as of `sj.animate`.
            mode: its number, as the table counts.

        Other args:
            view: azimuth and elevation of the viewer [deg]; chosen by the mechanism when None.
            reach: largest displacement, as a share of the size of the drawing.
            fps, overwrite: as of `sj.animate`.

        Returns:
            The path.

        Raises:
            SceneError: for a mode that does not exist or moves no body, a `reach` that is not positive, and as
                `sj.animate`.
        """
        from spherejax.output.plot.modes import film

        return film(self, mode, path, view=view, reach=reach, fps=fps, overwrite=overwrite)

    @property
    def _rows(self) -> list[tuple[str, ...]]:
        rows = []
        for k in range(min(len(self), SHOWN)):
            numbers = (f"{self.frequency[k]:.6g}", f"{self.damping_ratio[k]:.4g}", _complex(self.eigenvalues[k]))
            rows.append((str(k), *numbers, self._moves_most(k)))
        return rows

    def _moves_most(self, k: int) -> str:
        """The body that has most of the mode's mass-weighted motion."""
        z = self.shapes[k].reshape(-1)
        shares = np.real(z.conj() * (self.linear.coordinates.mass @ z)).reshape(-1, 6).sum(axis=1)
        return self.bodies[int(np.argmax(shares))] if shares.sum() > 0 else "memory"

    @property
    def _notes(self) -> list[str]:
        notes = []
        if len(self) > SHOWN:
            notes.append(f"... and {len(self) - SHOWN} more")
        if self.n_zero:
            notes.append(f"{self.n_zero} zero eigenvalues: free motions that nothing resists, and neutral positions")
        return notes + self.linear.notes

    def __str__(self) -> str:
        rows = [HEAD, *self._rows]
        widths = [max(len(row[i]) for row in rows) for i in range(len(HEAD))]
        aligned = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
        return "\n".join([f"Modes {self.linear.point.words}", *aligned, *self._notes])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        def line(cells, tag: str) -> str:
            return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

        body = "".join(line(row, "td") for row in self._rows)
        notes = "".join(f"<p>{escape(note)}</p>" for note in self._notes)
        caption = f"<caption>Modes {escape(self.linear.point.words)}</caption>"
        return f"<table>{caption}{line(HEAD, 'th')}{body}</table>{notes}"


HEAD = ("mode", "frequency [Hz]", "damping ratio", "eigenvalue [1/s]", "moves most")


def _complex(value: complex) -> str:
    if abs(value.imag) <= REAL * abs(value):
        return f"{value.real:.6g}"
    return f"{value.real:.6g} + {value.imag:.6g}i"


def _one_of_pairs(found: Eigen) -> np.ndarray:
    """Indices of the eigenvalues with Im >= 0, by size; of equal size the one that oscillates faster first."""
    values = found.values
    upper = np.flatnonzero(np.imag(values) >= -REAL * np.abs(values))
    order = np.lexsort((-np.imag(values[upper]), np.round(np.abs(values[upper]), 12)))
    return upper[order]


def _normalizing(z: Complex[np.ndarray, " n"], mass: np.ndarray) -> complex:
    """The factor that makes z^H M z = 1 and the largest entry real and positive."""
    size = float(np.sqrt(np.real(z.conj() @ (mass @ z))))
    if not size > 1e-12:
        return 1.0
    largest = z[np.argmax(np.abs(z))]
    return largest.conjugate() / abs(largest) / size


def _slope_of_matrix(linear: Any, name: str) -> Float[np.ndarray, "n_x n_x"]:
    """Total derivative of A by a number, in coordinates that turn as little as the constraints allow."""
    point, coordinates = linear.point, linear.coordinates
    number = number_at(point.whole, name)
    theta_slope, y_slope = slopes_of(point, number)
    speeds = slice(point.system.layout.n_position, point.system.layout.memory_start)
    moving = np.abs(point.y[speeds]) + np.abs(y_slope[speeds] * number.size(point.whole))
    if np.any(moving > STANDING):
        raise SceneError(
            f"derivatives of eigenvalues are for a state without velocities; {point.words} bodies move, and {name!r} "
            "would change how the coordinates turn. Take differences of two linearizations"
        )
    changed = point.equations.geometry_by_number(theta_slope, y_slope)
    moved = max(float(np.abs(np.asarray(each)).max(initial=0.0)) for each in (changed.residual, changed.violation))
    if moved > LEFT_OVER and point.origin == "run":
        raise SceneError(
            f"{name!r} moves the constraints, and nothing says how the state of a run follows. Linearize the scene, "
            "whose start and rest position do"
        )
    basis_slope, inverse_slope = coordinates.slopes(linear.geometry, changed, number.size(point.whole))
    basis, inverse = coordinates.basis, coordinates.inverse
    through = theta_slope, y_slope, basis_slope
    whole = inverse_slope @ linear.rates
    whole = whole + inverse @ point.equations.rates_along_by_number(linear.turning, basis, *through)
    kept = linear.kept
    return whole[np.ix_(kept, kept)]


STANDING = 1e-9
"""Velocities [m/s, rad/s] below this are rounding."""

LEFT_OVER = 1e-9
"""Derivatives of constraints above this are no rounding."""
