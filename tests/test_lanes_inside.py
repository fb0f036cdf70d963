"""States inside an explicit step, from its stages; and the flags that the lanes' speed rests on."""

import diffrax
import numpy as np
import pytest

from spherejax.motion.lanes.inside import extension, trees_of
from spherejax.motion.lanes.stages import ExplicitStages
from spherejax.runtime import _with_flags


def stages_of(solver):
    """Coefficients and weights of the stages that the end of a step needs."""
    steps = ExplicitStages(solver.tableau, lambda t, y, _: y, with_dense_output=False)
    n = steps.n_stages
    return steps.coefficients[:n, :n], steps.weights[:n], steps.inside


def test_the_number_of_rooted_trees():
    assert [len(trees_of(n)) for n in range(1, 8)] == [1, 1, 2, 4, 9, 20, 48]


@pytest.mark.parametrize(("solver", "order"), [(diffrax.Dopri8(), 5), (diffrax.Tsit5(), 4), (diffrax.Dopri5(), 4)])
def test_states_inside_a_step_have_the_order_that_the_stages_allow(solver, order):
    a, b, inside = stages_of(solver)
    assert inside.shape == (len(b), order + 1)
    assert np.allclose(inside.sum(axis=1), b, atol=1e-13)
    powers = np.arange(1, order + 2)

    def error(h, x=0.4):
        """Of y' = y^2, y(0) = 1, at the fraction x of a step h."""
        k = np.zeros(len(b))
        for i in range(len(b)):
            k[i] = h * (1 + a[i] @ k) ** 2
        return abs(1 + (inside @ x**powers) @ k - 1 / (1 - x * h))

    slope = np.log2(error(0.08) / error(0.04))
    assert slope == pytest.approx(order + 1, abs=0.5)


def test_a_method_of_order_one_has_a_straight_line_inside():
    assert extension(np.zeros((1, 1)), np.ones(1)).tolist() == [[1.0, 0.0]]


def test_flags_of_the_user_are_kept():
    assert "--xla_cpu_prefer_vector_width=512" in _with_flags("")
    assert "vector_width=512" not in _with_flags("--xla_cpu_prefer_vector_width=256")
    mine = "--xla_backend_extra_options=my_option"
    assert _with_flags(mine).startswith(mine + ",xla_cpu_small_while_loop_byte_threshold=")
    assert _with_flags(_with_flags(mine)) == _with_flags(mine)
