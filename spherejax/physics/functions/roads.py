"""Roads that are rough at random, by the classes of ISO 8608."""

from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement, concretely, is_concrete
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.forms import whole_number
from spherejax.foundations.legal import above, non_negative, positive
from spherejax.foundations.types import Listed, Number, Numeric, Scalar, Unit
from spherejax.physics.functions.base import AbstractFunction

ROAD_CLASSES = {name: 16e-6 * 4**k for k, name in enumerate("ABCDEFGH")}
"""Geometric means of the displacement spectral density at 0.1 cycles/m [m^3] by class; ISO 8608:2016, Table C.1."""

REFERENCE = 0.1
"""n_0, the spatial frequency at which a road's roughness is stated [cycles/m]; ISO 8608:2016."""

LARGEST_WAVINESS = 10.0
"""Beyond it the sum of powers leaves the numbers of 64 bits; roads have 1.5 to 3.5."""


class RandomRoad(AbstractFunction):
    """A road whose height has the spectral density of ISO 8608, a sum of waves with phases drawn at random.

        G(n) = roughness (n/n_0)^-waviness,    n_0 = 0.1 cycles/m
        z(x) = sum_k (2 V_k)^(1/2) (cos(2 pi n_k x + phi_k) - cos(phi_k)),    V_k = integral of G over the k-th band

    The bands divide the range from `lowest` to `highest` evenly on a logarithmic scale; each wave lies at random in its
    band, so that the road does not repeat itself. The variance of each band is exact. The road begins at height 0.

        sj.forces.Tyre("wheel.center", radius=0.32, stiffness=2e5, road=sj.functions.RandomRoad.of_class("C", seed=1),
        speed=20.0)

    Attributes:
        roughness: G(n_0) [m^3]; `RandomRoad.of_class("C")` for that of a class, "A" (smooth) to "H".
        waviness: of the density, above 1 [-].
        lowest: lowest spatial frequency, in cycles per meter [1/m].
        highest: highest one; a tyre as a spring at a point follows waves that its patch would bridge [1/m].
        phases: phi_k [rad], shape (n,).
        places: of the waves in their bands, from 0 to 1, shape (n,).

    Args:
        seed: of the random numbers; a whole number, which may be traced.
        n_waves: number of bands.

    Limits: linear in the square root of the roughness, whose derivative is infinite at 0.

    Source: ISO 8608:2016, Eq. C.2 (density), Annex C (classes, n_0, the range 0.011 to 2.83 cycles/m).
    """

    roughness: Number
    waviness: Number
    lowest: Number
    highest: Number
    phases: Numeric
    places: Numeric

    def __init__(
        self,
        roughness: Annotated[Number, Unit("m^3")],
        seed: Annotated[Number, Unit("1")] = 0,
        *,
        waviness: Annotated[Number, Unit("1")] = 2.0,
        lowest: Annotated[Number, Unit("1/m")] = 0.011,
        highest: Annotated[Number, Unit("1/m")] = 2.83,
        n_waves: Annotated[int, Unit("1")] = 64,
        phases: Annotated[Listed | None, Unit("rad")] = None,
        places: Annotated[Listed | None, Unit("1")] = None,
    ):
        self.roughness = roughness
        self.waviness = waviness
        self.lowest = lowest
        self.highest = highest
        drawn: Any = (phases, places)
        if phases is None or places is None:
            n = whole_number("n_waves", int(n_waves), "It counts the waves.", least=2)
            drawn = concretely(lambda s: _drawn(s, n), _seed(seed))
        self.phases, self.places = drawn

    @classmethod
    def of_class(cls, name: str, seed: Number = 0, **options: Any) -> "RandomRoad":
        """A road of a class of ISO 8608, with the geometric mean of its roughness.

        Args:
            name: "A" (smooth) to "H".
            seed: of the random numbers.
            **options: of `RandomRoad`.

        Raises:
            SceneError: for another class.
        """
        if name not in ROAD_CLASSES:
            raise SceneError(f"there is no road class {name!r}; {one_of(ROAD_CLASSES, str(name).upper())}")
        return cls(ROAD_CLASSES[name], seed, **options)

    def __call__(self, x: Number) -> Scalar:
        """z(x) [m]."""
        n = np.shape(self.phases)[0]
        ratio, w = jnp.asarray(self.highest / self.lowest), self.waviness - 1.0
        edges = self.lowest * ratio ** (np.arange(n + 1) / n)
        powers = (edges / REFERENCE) ** -w
        variances = self.roughness * REFERENCE / w * (powers[:-1] - powers[1:])
        places = jnp.asarray(self.places)
        frequencies = self.lowest * ratio ** ((np.arange(n) + places) / n)
        phases = jnp.asarray(self.phases)
        waves = jnp.cos(2 * np.pi * frequencies * x + phases) - jnp.cos(phases)
        return jnp.sum(jnp.sqrt(2.0 * variances) * waves)

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar:
        """Half of the shortest wave, from anywhere."""
        del x, is_forward
        return 0.5 / jnp.asarray(self.highest)

    def requirements(self) -> list[Requirement]:
        """A roughness that is not negative, a range, a waviness above 1."""
        waviness = self.waviness
        is_legal = (waviness > 1.0) & (waviness < LARGEST_WAVINESS)
        return [
            non_negative("roughness", self.roughness, "m^3"),
            positive("lowest", self.lowest, "cycles/m"),
            above("highest", self.highest, "lowest", self.lowest),
            Requirement("waviness", waviness, is_legal, "lie between 1 and 10", "ISO 8608 has 2; roads 1.5 to 3.5."),
        ]


def _seed(seed: Number) -> Any:
    if is_concrete(seed):
        return np.asarray(whole_number("seed", int(seed) if seed == int(seed) else seed, "It is a seed.", least=0))
    return seed


def _drawn(seed: Any, n: int) -> tuple[Any, Any]:
    """Phases and places of waves."""
    key = jax.random.key(jnp.asarray(seed, jnp.int64))
    phases, places = jax.random.uniform(key, (2, n), jnp.float64)
    return 2 * np.pi * phases, places
