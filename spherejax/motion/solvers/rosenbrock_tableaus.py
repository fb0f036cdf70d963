"""The coefficients of Rosenbrock methods: Rodas4P, Rodas5P and ROS34PW2.

A Rosenbrock method solves, in each stage i of a step of size h from (t, y), one linear system with one and
the same matrix. In the form that needs no product with the Jacobian J (Hairer & Wanner, section IV.7),

    (I/gamma - h J) k_i = h f(t + c_i h, y + sum_j A_ij k_j) + sum_j C_ij k_j + d_i h^2 f_t,    j < i
    y_new = y + sum_i b_i k_i

with J = df/dy and f_t = df/dt at (t, y). The error estimate is sum_i e_i k_i. All are stiffly accurate and L-stable:
for f = lambda y, y_new -> 0 as h lambda -> infinity. In Rodas4P and Rodas5P the last stage is evaluated at the
embedded solution of the order below and y_new differs from it by k_s alone, so that k_s is the error estimate.
ROS34PW2 is a W-method: it keeps its order whatever matrix stands for J, and whatever vector for f_t; exact ones make
it stable on stiff equations.

The dense output at t + theta h is, with u_j = sum_i H_ji k_i and Horner's scheme inside the brackets,

    y(theta) = (1 - theta) y + theta (y_new + (1 - theta) (u_1 + theta u_2 + theta^2 u_3))

The classical coefficients are, with Gamma = inv(I/gamma - C): alpha = A Gamma, the weights b Gamma, c_i =
sum_j alpha_ij and d_i = sum_j Gamma_ij (Hairer & Wanner, section IV.7).

Sources: G. Steinebach, "Order reduction of ROW methods for DAEs and method of lines applications", Preprint
1741, TH Darmstadt, 1995 (Rodas4P). G. Steinebach, "Construction of Rosenbrock-Wanner method Rodas5P and
numerical benchmarks within the Julia Differential Equations package", BIT Numerical Mathematics 63:27, 2023
(Rodas5P). The decimals of both are those of OrdinaryDiffEq.jl. J. Rang, L. Angermann, "New Rosenbrock W-methods of
order 3 for partial differential algebraic equations of index 1", BIT Numerical Mathematics 45:761-787, 2005
(ROS34PW2). E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd edition, Springer 1996, sections
IV.7 and VI.4.
"""

from typing import NamedTuple

import numpy as np


class RosenbrockTableau(NamedTuple):
    """The coefficients of a method with s stages, in the letters of the module docstring; dimensionless."""

    order: int
    """Order p of y_new; the embedded solution and the dense output have order p - 1."""
    gamma: float
    A: np.ndarray
    """(s, s), strictly lower triangular."""
    C: np.ndarray
    """(s, s), strictly lower triangular."""
    b: np.ndarray
    """(s,); the last entry is one."""
    e: np.ndarray
    """(s,): weights of the error estimate."""
    c: np.ndarray
    """(s,)"""
    d: np.ndarray
    """(s,)"""
    H: np.ndarray
    """(number of terms, s): weights of the dense output."""

    @property
    def n_stages(self) -> int:
        """s, which is also the number of evaluations of f in a step."""
        return len(self.c)


def lower_triangular(*rows: list[float]) -> np.ndarray:
    """The square matrix whose row i + 1 begins with the i + 1 numbers `rows[i]`, zero elsewhere."""
    matrix = np.zeros((len(rows) + 1, len(rows) + 1))
    for i, row in enumerate(rows, start=1):
        matrix[i, :i] = row
    return matrix


RODAS4P = RosenbrockTableau(
    order=4,
    gamma=0.25,
    A=lower_triangular(
        [3.0],
        [1.831036793486759, 0.4955183967433795],
        [2.304376582692669, -0.05249275245743001, -1.176798761832782],
        [-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401],
        [-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401, 1.0],
    ),
    C=lower_triangular(
        [-12.0],
        [-8.791795173947035, -2.207865586973518],
        [10.81793056857153, 6.780270611428266, 19.5348594464241],
        [34.19095006749676, 15.49671153725963, 54.7476087596413, 14.16005392148534],
        [34.62605830930532, 15.30084976114473, 56.99955578662667, 18.40807009793095, -5.714285714285717],
    ),
    b=np.array([-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401, 1.0, 1.0]),
    e=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
    c=np.array([0.0, 0.75, 0.21, 0.63, 1.0, 1.0]),
    d=np.array([0.25, -0.5, -0.023504, -0.0362, 0.0, 0.0]),
    H=np.array(
        [
            [25.09876703708589, 11.62013104361867, 28.49148307714626, -5.664021568594133, 0.0, 0.0],
            [
                1.638054557396973,
                -0.7373619806678748,
                8.47791821923899,
                15.9925314877952,
                -1.882352941176471,
                0.0,
            ],
        ]
    ),
)

RODAS5P = RosenbrockTableau(
    order=5,
    gamma=0.21193756319429014,
    A=lower_triangular(
        [3.0],
        [2.849394379747939, 0.45842242204463923],
        [-6.954028509809101, 2.489845061869568, -10.358996098473584],
        [2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641],
        [
            -7.502846399306121,
            2.561846144803919,
            -11.627539656261098,
            -0.18268767659942256,
            0.030198172008377946,
        ],
        [
            -7.502846399306121,
            2.561846144803919,
            -11.627539656261098,
            -0.18268767659942256,
            0.030198172008377946,
            1.0,
        ],
        [
            -7.502846399306121,
            2.561846144803919,
            -11.627539656261098,
            -0.18268767659942256,
            0.030198172008377946,
            1.0,
            1.0,
        ],
    ),
    C=lower_triangular(
        [-14.155112264123755],
        [-17.97296035885952, -2.859693295451294],
        [147.12150275711716, -1.41221402718213, 71.68940251302358],
        [165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306],
        [24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471],
        [
            30.91273214028599,
            -3.1208243349937974,
            77.79954646070892,
            34.28646028294783,
            -19.097331116725623,
            -28.087943162872662,
        ],
        [
            37.80277123390563,
            -3.2571969029072276,
            112.26918849496327,
            66.9347231244047,
            -40.06618937091002,
            -54.66780262877968,
            -9.48861652309627,
        ],
    ),
    b=np.array(
        [
            -7.502846399306121,
            2.561846144803919,
            -11.627539656261098,
            -0.18268767659942256,
            0.030198172008377946,
            1.0,
            1.0,
            1.0,
        ]
    ),
    e=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
    c=np.array([0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0, 1.0]),
    d=np.array(
        [
            0.21193756319429014,
            -0.42387512638858027,
            -0.3384627126235924,
            1.8046452872882734,
            2.325825639765069,
            0.0,
            0.0,
            0.0,
        ]
    ),
    H=np.array(
        [
            [
                25.948786856663858,
                -2.5579724845846235,
                10.433815404888879,
                -2.3679251022685204,
                0.524948541321073,
                1.1241088310450404,
                0.4272876194431874,
                -0.17202221070155493,
            ],
            [
                -9.91568850695171,
                -0.9689944594115154,
                3.0438037242978453,
                -24.495224566215796,
                20.176138334709044,
                15.98066361424651,
                -6.789040303419874,
                -6.710236069923372,
            ],
            [
                11.419903575922262,
                2.8879645146136994,
                72.92137995996029,
                80.12511834622643,
                -52.072871366152654,
                -59.78993625266729,
                -0.15582684282751913,
                4.883087185713722,
            ],
        ]
    ),
)


def w_method(
    order: int, alpha: np.ndarray, Gamma: np.ndarray, b: np.ndarray, b_embedded: np.ndarray
) -> RosenbrockTableau:
    """The tableau of a W-method with four stages from its classical coefficients (Hairer & Wanner, section IV.7).

    The dense output y + sum_i b_i(theta) h f_i is the cubic one of order 2 with any matrix (sum b_i = theta,
    sum b_i c_i = theta^2 / 2, sum b_i d_i = 0) that integrates functions of time to order 3 (sum b_i c_i^2 =
    theta^3 / 3). For ROS34PW2 it has order 3 with the exact matrix.
    """
    c, d = alpha.sum(1), Gamma.sum(1)
    inverse = np.linalg.inv(Gamma)
    conditions = np.stack([np.ones_like(c), c, d, c**2])
    wanted = np.array([[1.0, 0.0, 0.0], [0.0, 1 / 2, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1 / 3]])
    _, square, cube = np.linalg.solve(conditions, wanted).T
    return RosenbrockTableau(
        order=order,
        gamma=float(Gamma[0, 0]),
        A=alpha @ inverse,
        C=np.diag(np.diag(inverse)) - inverse,
        b=b @ inverse,
        e=(b - b_embedded) @ inverse,
        c=c,
        d=d,
        H=np.stack([-square - cube, -cube]) @ inverse,
    )


ROS34PW2 = w_method(
    order=3,
    alpha=lower_triangular(
        [0.87173304301691801],
        [0.84457060015369423, -0.11299064236484185],
        [0.0, 0.0, 1.0],
    ),
    Gamma=0.43586652150845900 * np.eye(4)
    + lower_triangular(
        [-0.87173304301691801],
        [-0.90338057013044082, 0.054180672388095326],
        [0.24212380706095346, -1.2232505839045147, 0.54526025533510214],
    ),
    b=np.array([0.24212380706095346, -1.2232505839045147, 1.5452602553351020, 0.43586652150845900]),
    b_embedded=np.array([0.37810903145819369, -0.096042292212423178, 0.5, 0.21793326075422950]),
)
