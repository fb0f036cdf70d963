"""DOP853, the explicit Runge-Kutta method of order 8 of Dormand and Prince in the form of Hairer and Wanner.

Twelve stages make a step, four more the states inside it. Two estimates of its error, of order 5 and 3, are made one:
e = e5^2 / sqrt(e5^2 + e3^2/100), which falls with h^8 as h does. Hairer's code joins their norms; here it is
done entry by entry, so that any norm may judge them, and sensitivities below a state have an estimate of their own.

Against Dopri8, also of order 8: one stage less, and stable up to h |lambda| = 6.4 along the negative real axis (5.2)
and 6.0 along the imaginary one (3.7); but up to sixty times the error at the same tolerance where that sets the steps.
A four-bar on a bushing of 1e8 N/m and 1e-4 s takes 0.6 of the time at an rtol of 1e-4, 0.84 at 1e-6 and at 1e-8; dry,
at 1e-8, 1.15 (`benchmarks/order_eight.py`).

Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd edition, Springer 1993,
section II.5 and appendix; the decimals are those of the code dop853.f.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

# fmt: off
_A: tuple[list[float], ...] = (
    [0.05260015195876773],
    [0.0197250569845379, 0.0591751709536137],
    [0.02958758547680685, 0, 0.08876275643042054],
    [0.2413651341592667, 0, -0.8845494793282861, 0.924834003261792],
    [0.037037037037037035, 0, 0, 0.17082860872947386, 0.12546768756682242],
    [0.037109375, 0, 0, 0.17025221101954405, 0.06021653898045596, -0.017578125],
    [0.03709200011850479, 0, 0, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402, 0.008273789163814023],
    [
        0.6241109587160757, 0, 0, -3.3608926294469414, -0.868219346841726, 27.59209969944671, 20.154067550477894,
        -43.48988418106996,
    ],
    [
        0.47766253643826434, 0, 0, -2.4881146199716677, -0.590290826836843, 21.230051448181193, 15.279233632882423,
        -33.28821096898486, -0.020331201708508627,
    ],
    [
        -0.9371424300859873, 0, 0, 5.186372428844064, 1.0914373489967295, -8.149787010746927, -18.52006565999696,
        22.739487099350505, 2.4936055526796523, -3.0467644718982196,
    ],
    [
        2.273310147516538, 0, 0, -10.53449546673725, -2.0008720582248625, -17.9589318631188, 27.94888452941996,
        -2.8589982771350235, -8.87285693353063, 12.360567175794303, 0.6433927460157636,
    ],
    [
        0.054293734116568765, 0, 0, 0, 0, 4.450312892752409, 1.8915178993145003, -5.801203960010585,
        0.3111643669578199, -0.1521609496625161, 0.20136540080403034, 0.04471061572777259,
    ],
    [
        0.056167502283047954, 0, 0, 0, 0, 0, 0.25350021021662483, -0.2462390374708025, -0.12419142326381637,
        0.15329179827876568, 0.00820105229563469, 0.007567897660545699, -0.008298,
    ],
    [
        0.03183464816350214, 0, 0, 0, 0, 0.028300909672366776, 0.053541988307438566, -0.05492374857139099, 0, 0,
        -0.00010834732869724932, 0.0003825710908356584, -0.00034046500868740456, 0.1413124436746325,
    ],
    [
        -0.42889630158379194, 0, 0, 0, 0, -4.697621415361164, 7.683421196062599, 4.06898981839711, 0.3567271874552811,
        0, 0, 0, -0.0013990241651590145, 2.9475147891527724, -9.15095847217987,
    ],
)
_B = [
    0.054293734116568765, 0, 0, 0, 0, 4.450312892752409, 1.8915178993145003, -5.801203960010585, 0.3111643669578199,
    -0.1521609496625161, 0.20136540080403034, 0.04471061572777259, 0, 0, 0, 0,
]
_C = [
    0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726, 0.3333333333333333, 0.25,
    0.3076923076923077, 0.6512820512820513, 0.6, 0.8571428571428571, 1.0, 1.0, 0.1, 0.2, 0.7777777777777778,
]
_OF_FIFTH_ORDER = [
    0.01312004499419488, 0, 0, 0, 0, -1.2251564463762044, -0.4957589496572502, 1.6643771824549864,
    -0.35032884874997366, 0.3341791187130175, 0.08192320648511571, -0.022355307863886294, 0, 0, 0, 0,
]
_OF_THIRD_ORDER = [
    -0.18980075407240762, 0, 0, 0, 0, 4.450312892752409, 1.8915178993145003, -5.801203960010585, -0.4226823213237919,
    -0.1521609496625161, 0.20136540080403034, 0.02265179219836082, 0, 0, 0, 0,
]
_AT_THE_END = 12
"""The stage that begins the next step."""
_D = np.array([
        [
            -8.428938276109013, 0, 0, 0, 0, 0.5667149535193777, -3.0689499459498917, 2.38466765651207,
            2.117034582445028, -0.871391583777973, 2.2404374302607883, 0.6315787787694688, -0.08899033645133331,
            18.148505520854727, -9.194632392478356, -4.436036387594894,
        ],
        [
            10.427508642579134, 0, 0, 0, 0, 242.28349177525817, 165.20045171727028, -374.5467547226902,
            -22.113666853125306, 7.733432668472264, -30.674084731089398, -9.332130526430229, 15.697238121770845,
            -31.139403219565178, -9.35292435884448, 35.81684148639408,
        ],
        [
            19.985053242002433, 0, 0, 0, 0, -387.0373087493518, -189.17813819516758, 527.8081592054236,
            -11.57390253995963, 6.8812326946963, -1.0006050966910838, 0.7777137798053443, -2.778205752353508,
            -60.19669523126412, 84.32040550667716, 11.99229113618279,
        ],
        [
            -25.69393346270375, 0, 0, 0, 0, -154.18974869023643, -231.5293791760455, 357.6391179106141,
            93.40532418362432, -37.45832313645163, 104.0996495089623, 29.8402934266605, -43.53345659001114,
            96.32455395918828, -39.17726167561544, -149.72683625798564,
        ],
])
# fmt: on


@dataclass(frozen=True)
class TwoErrors(diffrax.ButcherTableau):
    """A tableau with weights of a second estimate of the error, of a lower order.

    Attributes:
        b_lower: weights of the estimate of the lower order, shape (s,).
    """

    b_lower: np.ndarray = field(kw_only=True)

    @staticmethod
    def together(error: Array, lower: Array) -> Array:
        """One estimate of both, entry by entry: e5^2 / sqrt(e5^2 + e3^2/100), zero where both are.

        In units of the larger one, for no square to leave the range of numbers: a trial step may go anywhere.
        """
        largest = jnp.maximum(jnp.abs(error), 0.1 * jnp.abs(lower))
        unit = jnp.where(largest > 0, largest, 1.0)
        share, rest = error / unit, 0.1 * lower / unit
        square = share * share + rest * rest
        return jnp.where(largest > 0, error * share / jnp.sqrt(jnp.where(largest > 0, square, 1.0)), 0.0)


class _Interpolation(diffrax.AbstractLocalInterpolation):
    """The state inside a step, of order 7, from the increments of all sixteen stages."""

    t0: Any
    t1: Any
    y0: Any
    y1: Any
    k: Any

    def evaluate(self, t0: Any, t1: Any = None, left: bool = True) -> Any:
        """At t0, or what it changes from there to t1."""
        del left
        if t1 is not None:
            return jax.tree.map(jnp.subtract, self.evaluate(t1), self.evaluate(t0))
        size = self.t1 - self.t0
        x = (t0 - self.t0) / jnp.where(size == 0, 1.0, size)
        return jax.tree.map(lambda *leaves: _inside(x, *leaves), self.y0, self.y1, self.k)


def _inside(x: Array, y0: Array, y1: Array, k: Array) -> Array:
    change, at_start, at_end = y1 - y0, k[0], k[_AT_THE_END]
    terms = [change, at_start - change, 2 * change - at_start - at_end, *jnp.tensordot(_D, k, 1)]
    state = jnp.zeros_like(y0)
    for i, term in reversed([*enumerate(terms)]):
        state = (state + term) * (x if i % 2 == 0 else 1 - x)
    return y0 + state


class Dop853(diffrax.AbstractERK):
    """DOP853: explicit, order 8, twelve stages a step; two estimates of the error, of order 5 and 3, made one.

    States inside a step are of order 7 and take four stages more. It goes all ways that `diffrax.Dopri8` goes (lanes,
    landing on contacts, derivatives), and its steps may be 1.2 to 1.6 times as long where stability limits them: stiff
    bushings at loose tolerances. Elsewhere Dopri8 is more exact for the same time. It has no parameters.

    Source: Hairer, Norsett and Wanner (1993), section II.5.
    """

    tableau: ClassVar[TwoErrors] = TwoErrors(
        c=np.array(_C),
        b_sol=np.array(_B),
        b_error=np.array(_OF_FIFTH_ORDER),
        a_lower=tuple(np.array(row, float) for row in _A),
        b_lower=np.array(_OF_THIRD_ORDER),
    )
    interpolation_cls: ClassVar[Callable[..., _Interpolation]] = _Interpolation

    def order(self, terms: Any) -> int:
        """Of the step; the error falls as for it."""
        del terms
        return 8

    def step(self, *arguments: Any, **how: Any) -> tuple:
        """One step, as diffrax makes it, with both estimates of the error."""
        y1, error, dense_info, *others = super().step(*arguments, **how)
        weights = jnp.asarray(self.tableau.b_lower)
        lower = jax.tree.map(lambda k: jnp.tensordot(weights, k, 1), dense_info["k"])
        return y1, jax.tree.map(TwoErrors.together, error, lower), dense_info, *others
