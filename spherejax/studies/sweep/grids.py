"""What is swept: names and values of parameters, by product, side by side, at random, or by Sobol's sequence."""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible
from spherejax.studies.random_numbers import Rng, generator, rng_was_seed
from spherejax.studies.sweep.spreads import Scattered, Spread, scattered

SLAB = 2**20
"""Runs whose parameters are in memory at a time, where not all of them need be."""


class Combinations(Mapping[str, Float[np.ndarray, " n_runs"]]):
    """Each parameter's value in each run of a product, made when it is asked for: 1e8 runs take 0.8 GB for each."""

    def __init__(self, axes: Mapping[str, Float[np.ndarray, " n"]]):
        self.axes = axes
        self.shape = tuple(len(values) for values in axes.values())

    def __getitem__(self, name: str) -> Float[np.ndarray, " n_runs"]:
        return self.between(name, 0, math.prod(self.shape))

    def __iter__(self) -> Iterator[str]:
        return iter(self.axes)

    def __len__(self) -> int:
        return len(self.axes)

    def between(self, name: str, start: int, stop: int) -> Float[np.ndarray, " n"]:
        """The values of some runs."""
        place = list(self.axes).index(name)
        # The last axis varies fastest.
        turns = np.arange(start, stop) // math.prod(self.shape[place + 1 :])
        return self.axes[name][turns % self.shape[place]]


@dataclass(frozen=True)
class Grid:
    """The runs of a sweep.

    Attributes:
        values: each parameter's value in each run, shape (n_runs,).
        axes: values of each parameter along its own axis, for a product; empty where runs are just numbered.
        kind: `"product"`, `"zipped"`, `"random"` or `"sobol"`.
    """

    values: Mapping[str, Float[np.ndarray, " n_runs"]]
    axes: Mapping[str, Float[np.ndarray, " n"]]
    kind: str

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return math.prod(self.shape)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.values)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes; one axis of runs where it is no product."""
        return tuple(len(values) for values in self.axes.values()) or (len(next(iter(self.values.values()))),)

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(self.axes) or ("run",)

    def rows(self, start: int, stop: int) -> dict[str, Float[np.ndarray, " n"]]:
        """The parameters of some runs."""
        return {name: self.between(name, start, stop) for name in self.names}

    def between(self, name: str, start: int, stop: int) -> Float[np.ndarray, " n"]:
        """One parameter of some runs."""
        if isinstance(self.values, Combinations):
            return self.values.between(name, start, stop)
        return self.values[name][start:stop]

    def row(self, run: int) -> dict[str, float]:
        """The parameters of one run."""
        return {name: values[0] for name, values in self.rows(run, run + 1).items()}

    def slabs(self, name: str) -> Iterator[Float[np.ndarray, " n"]]:
        """All values of one parameter, some runs at a time."""
        for start in range(0, self.n_runs, SLAB):
            yield self.between(name, start, min(start + SLAB, self.n_runs))

    @property
    def fingerprint(self) -> str:
        """A digest of names, values and order: two grids with the same one ask for the same runs."""
        digest = hashlib.sha256(repr((self.kind, self.dims, self.shape)).encode())
        for name in self.names:
            digest.update(name.encode())
            for values in self.slabs(name):
                digest.update(np.ascontiguousarray(values, np.float64).tobytes())
        return digest.hexdigest()


def product(values: Mapping[str, Any]) -> Grid:
    """Every combination; the last parameter varies fastest.

    Args:
        values: a list of numbers, or one number, for each parameter.

    Raises:
        SceneError: for no parameter, no value, or values that are not finite.
    """
    axes = {name: _numbers(name, given) for name, given in _named(values).items()}
    return Grid(Combinations(axes), axes, "product")


def zipped(values: Mapping[str, Any]) -> Grid:
    """The first values together, the second ones, and so on.

    Raises:
        SceneError: as `product`, and for lists of different length.
    """
    lists = {name: _numbers(name, given) for name, given in _named(values).items()}
    lengths = {name: len(each) for name, each in lists.items()}
    if len(set(lengths.values())) > 1:
        raise SceneError(f"zipped parameters need lists of equal length; they have {lengths}")
    return Grid(lists, {}, "zipped")


@rng_was_seed
def random_samples(ranges: Mapping[str, Spread], n: int, *, rng: Rng = 0, logarithmic: Sequence[str] = ()) -> Grid:
    """Independent samples.

    Args:
        ranges: of each parameter the least and largest value (uniform), a `sj.studies.Tolerance`, or a distribution of
            scipy.stats.
        n: number of runs.
        rng: of the random numbers: a whole number gives the same runs each time; a generator, or None for other runs.
        logarithmic: names of parameters whose logarithm is uniform.

    Raises:
        SceneError: for a range that is none, or a logarithm of what is not positive.
    """
    points = generator(rng).random((_positive(n), len(_named(ranges))))
    return _within(ranges, points, logarithmic, "random")


@rng_was_seed
def sobol_samples(ranges: Mapping[str, Spread], n: int, *, rng: Rng = 0, logarithmic: Sequence[str] = ()) -> Grid:
    """Samples of a scrambled Sobol sequence, which fill ranges and distributions evenly; best with a power of two.

    Arguments and errors as `random_samples`.

    Source: scipy.stats.qmc.Sobol.
    """
    from scipy.stats import qmc

    sequence = qmc.Sobol(len(_named(ranges)), rng=generator(rng))
    exponent = int(np.ceil(np.log2(_positive(n))))
    return _within(ranges, sequence.random_base2(exponent)[:n], logarithmic, "sobol")


def as_grid(grid: "Grid | Mapping[str, Any]") -> Grid:
    """A grid as it is; a mapping of lists as their product."""
    return grid if isinstance(grid, Grid) else product(grid)


def _within(ranges: Mapping[str, Spread], points, logarithmic: Sequence[str], kind: str) -> Grid:
    unknown = sorted(set(logarithmic) - set(ranges))
    if unknown:
        raise SceneError(f"logarithmic={unknown[0]!r} names no parameter; there are {', '.join(map(repr, ranges))}")
    values = {}
    for column, (name, given) in enumerate(ranges.items()):
        spread = scattered(name, given)
        values[name] = _logarithmic(spread, points[:, column]) if name in logarithmic else spread.at(points[:, column])
    return Grid(values, {}, kind)


def _logarithmic(spread: Scattered, points: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    if not spread.is_range:
        raise SceneError(
            f"parameter {spread.name!r}: logarithmic= is for ranges (least, largest); of a distribution take that of "
            "the logarithm, e.g. scipy.stats.lognorm"
        )
    low, high = (float(end) for end in spread.distribution.support())
    if not low > 0:
        raise SceneError(f"parameter {spread.name!r}: a logarithmic range must be positive; it is {low:g} to {high:g}")
    return np.exp(np.log(low) + points * np.log(high / low))


def _named(values: Mapping[str, Any]) -> Mapping[str, Any]:
    if not isinstance(values, Mapping) or not values:
        raise SceneError('a sweep needs parameters: give a mapping of names, e.g. {"clearance": [5e-5, 1e-4, 2e-4]}')
    return values


def _numbers(name: str, given) -> Float[np.ndarray, " n"]:
    if not all(map(is_concrete, jax.tree.leaves(given))):
        raise SceneError(
            f"parameter {name!r} is traced (within jax.jit, jax.grad or jax.vmap), and a sweep takes numbers. For "
            "derivatives record sensitivities, sj.studies.Sensitivity(...), or map runs of your own: "
            "jax.vmap(jax.grad(lambda x: ...sj.simulate(...)))"
        )
    try:
        numbers = np.atleast_1d(np.asarray(visible(given)))
        if numbers.dtype.kind not in "fiuO":  # NumPy would make numbers of texts, times and truth values
            raise TypeError(f"{numbers.dtype} is no kind of number")
        numbers = numbers.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"parameter {name!r} must be a list of numbers; it is {given!r}") from error
    if numbers.ndim != 1 or numbers.size == 0:
        raise SceneError(f"parameter {name!r} must be a list of numbers; it has shape {numbers.shape}")
    if not np.all(np.isfinite(numbers)):
        raise SceneError(f"parameter {name!r} must be finite; entry {int(np.argmin(np.isfinite(numbers)))} is not")
    return numbers


def _positive(n: int) -> int:
    if n < 1:
        raise SceneError(f"a sweep needs at least one run; n = {n}")
    return n
