"""No case of the adversarial scenes in `adversary.py` gives a wrong number without saying so."""

import adversary
import numpy as np
import pytest
from adversary import FAMILIES, Family, Verdict, verdicts

import spherejax as sj

pytestmark = pytest.mark.filterwarnings(
    "ignore::spherejax.errors.SerialRunsWarning"
)  # times that differ from case to case

FAST = (
    "wheel on a torsion spring",
    "gears",
    "prescribed jump, a Step",
    "pulse",
    "closure",
    "derivative by what a function closes over",
    "derivative by a sample time",
    "derivative through a linear stop",
    "force: 1/t",
)
"""Families whose programs compile in a few seconds, one of each kind."""

FEW, MANY = 4, 1000
"""Cases of a family in the fast tests; of all families together in the slow ones."""


def judged(name: str, n: int) -> list[Verdict]:
    cases = verdicts(FAMILIES[name], range(n))
    silent = [case.words for case in cases if case.kind == "SILENT"]
    assert not silent, f"{name}: {len(silent)} of {n} wrong in silence:\n" + "\n".join(silent)
    right = sum(case.kind == "right" for case in cases)
    told = "\n".join(case.words for case in cases if case.kind == "told")
    assert right >= FAMILIES[name].least_right * n, f"{name}: only {right} of {n} right; the others:\n{told}"
    return cases


@pytest.mark.parametrize("name", FAST)
def test_few_cases_are_right_or_told(name):
    judged(name, FEW)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_a_thousand_cases_are_right_or_told(name):
    judged(name, -(-MANY // len(FAMILIES)))


def test_a_wrong_answer_is_seen():
    """The judge itself: what is wrong without a word is `SILENT`, and what is told is not."""
    family = FAMILIES["derivative by a sample time"]
    numbers = family.draw(np.random.default_rng(0))
    silent = np.zeros(len(sj.Status))
    right = family.right(**numbers)
    judge = adversary._judged
    assert judge(family, numbers, right, 0, silent, "").kind == "right"
    assert judge(family, numbers, right + 1.0, 0, silent, "").kind == "SILENT"
    assert judge(family, numbers, np.nan, 0, silent, "").kind == "SILENT"
    assert judge(family, numbers, right + 1.0, 6, silent, "").kind == "told"
    assert judge(family, numbers, right + 1.0, 0, silent, "a warning").kind == "told"
    assert isinstance(family, Family)
