"""`sj.studies.dynamic_stiffness`: what a test stand measures of a bushing, over frequency and amplitude."""

import os
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from spherejax.foundations.checks import enforce, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import malformed, shape_of
from spherejax.foundations.types import Number, Numeric
from spherejax.output.io import save
from spherejax.output.paths import writable
from spherejax.output.tables import write_rows
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.harmonic import complex_stiffness
from spherejax.physics.laws.elastomer import AbstractElastomer

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

COLUMNS = ("frequency", "amplitude", "stiffness", "loss_angle")
"""Of a table."""

SHOWN = 12
"""Rows of a table that is printed, at most."""


class DynamicStiffness(eqx.Module):
    """Dynamic stiffness and loss angle over frequency and amplitude; prints as a table.

    Attributes:
        frequency: of the harmonic motion, shape (n,) [Hz].
        amplitude: of the deflection, half of what lies between its ends, shape (m,) [m], or of the rotation [rad].
        complex_stiffness: K' + i K'', shape (n, m) [N/m], or [N m/rad].
        rotation: whether it is against rotation (static).
    """

    frequency: Float[Array, " n"]
    amplitude: Float[Array, " m"]
    complex_stiffness: Complex[Array, "n m"]
    rotation: bool = eqx.field(static=True, default=False)

    @property
    def stiffness(self) -> Float[Array, "n m"]:
        """Dynamic stiffness |K|: amplitude of the force, its first harmonic, over that of the deflection."""
        return jnp.abs(self.complex_stiffness)

    @property
    def loss_angle(self) -> Float[Array, "n m"]:
        """By which the force runs ahead of the deflection, arg K [rad]."""
        return jnp.angle(self.complex_stiffness)

    @property
    def storage(self) -> Float[Array, "n m"]:
        """K', of the part in phase with the deflection."""
        return jnp.real(self.complex_stiffness)

    @property
    def loss(self) -> Float[Array, "n m"]:
        """K'', of the part ahead by a quarter of a cycle; a cycle loses pi K'' x_0^2."""
        return jnp.imag(self.complex_stiffness)

    @property
    def units(self) -> dict[str, str]:
        """Of the columns of a table."""
        return dict(
            zip(COLUMNS, ("Hz", "rad", "N m/rad", "rad") if self.rotation else ("Hz", "m", "N/m", "rad"), strict=True)
        )

    def to_xarray(self) -> "xarray.Dataset":
        """`stiffness`, `loss_angle`, `storage` and `loss` over `frequency` and `amplitude`, with units."""
        import xarray

        over, units = ("frequency", "amplitude"), self.units
        unit = {"units": units["stiffness"]}
        return xarray.Dataset(
            {
                "stiffness": (over, np.asarray(self.stiffness), {**unit, "long_name": "dynamic stiffness"}),
                "loss_angle": (over, np.asarray(self.loss_angle), {"units": "rad", "long_name": "loss angle"}),
                "storage": (over, np.asarray(self.storage), {**unit, "long_name": "storage stiffness"}),
                "loss": (over, np.asarray(self.loss), {**unit, "long_name": "loss stiffness"}),
            },
            {name: (name, np.asarray(getattr(self, name)), {"units": units[name]}) for name in over},
        )

    @property
    def rows(self) -> Float[np.ndarray, "nm 4"]:
        """Frequency, amplitude, dynamic stiffness and loss angle of each measurement, one below the other."""
        f, a = np.meshgrid(np.asarray(self.frequency), np.asarray(self.amplitude), indexing="ij")
        return np.stack([f, a, np.asarray(self.stiffness), np.asarray(self.loss_angle)], -1).reshape(-1, 4)

    def save(self, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
        """Write netCDF (.nc), or a table (.csv) with a row for each frequency and amplitude, as `fit_stiffness` reads.

        Raises:
            SceneError: as `sj.save`.
        """
        path = writable(path, overwrite=overwrite)
        if path.suffix == ".nc":
            return save(self.to_xarray(), path, overwrite=overwrite)
        heads = [f"{name} [{self.units[name]}]" for name in COLUMNS]
        write_rows(path, heads, ([repr(float(x)) for x in row] for row in self.rows))
        return path

    def figure(self, title: str = "") -> "Figure":
        """Dynamic stiffness and loss angle over frequency, a curve for each amplitude."""
        from spherejax.output.plot.stiffness import dynamic_stiffness

        return dynamic_stiffness({"": self.to_xarray()}, title or "Dynamic stiffness")

    def __str__(self) -> str:
        rows, units = self.rows, self.units
        lines = [f"frequency [Hz]  amplitude [{units['amplitude']}]  |K| [{units['stiffness']}]  loss angle [deg]"]
        lines += [f"{f:14.6g}  {a:13.6g}  {k:12.6g}  {np.degrees(d):16.4g}" for f, a, k, d in rows[:SHOWN]]
        more = len(rows) - SHOWN
        return "\n".join([*lines, f"... and {more} more"] if more > 0 else lines)


def dynamic_stiffness(
    model: Bushing | AbstractElastomer,
    frequencies: Numeric,
    amplitudes: Numeric,
    *,
    direction: Numeric = (1.0, 0.0, 0.0),
    rotation: bool = False,
    mean: Number = 0.0,
) -> DynamicStiffness:
    """Dynamic stiffness and loss angle of a bushing in steady harmonic motion, over frequency and amplitude.

    Of a nonlinear law the first harmonic of the force counts, as on a test stand. Branches and friction are taken in
    closed form and the elastomer over one cycle; nothing is integrated in time. Works under `jit`, `vmap` and `grad`,
    where numbers that make no sense give NaN.

    Args:
        model: a bushing, or an elastomer alone.
        frequencies: [Hz], one or several.
        amplitudes: half of what lies between the ends [m], or [rad] for rotation; one or several.

    Other args:
        direction: along or about which it moves, in the socket's axes, any length.
        rotation: turn about the direction instead of moving along it.
        mean: about which it moves, along the direction [m], or [rad]; branches and friction have forgotten how it came
            there.

    Returns:
        A table: it prints, `.to_xarray()`, `.save(path)`, `.figure()`.

    Raises:
        SceneError: for a model without a stiffness, numbers that make no sense, rotation that the law leaves free.
    """
    bushing, conditions = checked(model, rotation)
    f, x = _positive("frequencies", frequencies), _positive("amplitudes", amplitudes)
    table = _table(bushing, f, x, unit_vector(direction), jnp.asarray(mean, float), rotation=rotation)
    conditions = [(f > 0)[:, None] & (x > 0), *conditions]
    return DynamicStiffness(f, x, jnp.where(reduce(jnp.logical_and, conditions), table, jnp.nan), rotation)


def _all_stiffnesses(model: Bushing, frequencies, amplitudes, direction, mean, *, rotation: bool):
    def one(frequency, amplitude):
        return complex_stiffness(model, frequency, amplitude, direction, mean, rotation=rotation)

    return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(frequencies, amplitudes)


_table = jax.jit(_all_stiffnesses, static_argnames="rotation")


def checked(model: Any, rotation: bool) -> tuple[Bushing, list]:
    """The bushing, its numbers judged, and conditions on those that are traced."""
    bushing = Bushing(law=model) if isinstance(model, AbstractElastomer) else model
    if not isinstance(bushing, Bushing):
        raise SceneError(
            f"dynamic_stiffness: {type(model).__name__} has no dynamic stiffness; give a Bushing, or an elastomer"
        )
    enforce("dynamic_stiffness", malformed(bushing))
    conditions = enforce("dynamic_stiffness", bushing.requirements())
    if rotation and not bushing.law.resists_rotation:
        law = type(bushing.law).__name__
        raise SceneError(f"dynamic_stiffness: {law} leaves rotation free; leave out rotation=True, or take another law")
    return bushing, conditions


def _positive(name: str, value: Any) -> Array:
    """One or several numbers above zero, as an array of one axis."""
    shape = shape_of(value)
    if shape is None or len(shape) > 1 or 0 in shape:
        raise SceneError(f"dynamic_stiffness: {name} = {value!r} must be one or several numbers above zero")
    array = jnp.atleast_1d(jnp.asarray(value, float))
    if is_concrete(array) and not np.all((np.asarray(array) > 0) & np.isfinite(np.asarray(array))):
        raise SceneError(f"dynamic_stiffness: {name} = {value!r} must be above zero and finite")
    return array


def unit_vector(direction: Any) -> Array:
    """A direction of length one."""
    if shape_of(direction) != (3,):
        raise SceneError(f"dynamic_stiffness: direction = {direction!r} must be three numbers, e.g. (1.0, 0.0, 0.0)")
    vector = jnp.asarray(direction, float)
    if is_concrete(vector) and not 0 < float(vector @ vector) < np.inf:
        raise SceneError(f"dynamic_stiffness: direction = {direction!r} must have a length, e.g. (1.0, 0.0, 0.0)")
    return vector / jnp.sqrt(vector @ vector)
