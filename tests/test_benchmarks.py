"""What benchmarks count themselves."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent.parent / "benchmarks"))

from sweep_lanes import kernels_per_turn

PROGRAM = """HloModule jit_f

%inner (arg: (s64[], f64[9])) -> (s64[], f64[9]) {
  %wrapped_sine = f64[9]{0} fusion(%get-tuple-element.1), kind=kLoop, calls=%sine
  %sort.4 = f64[9]{0} sort(%wrapped_sine), dimensions={0}, to_apply=%region_2
  ROOT %tuple.1 = (s64[], f64[9]{0}) tuple(%add.1, %sort.4)
}

%until (arg.2: (s64[], f64[9])) -> pred[] {
  %constant.4 = s64[] constant(5)
  ROOT %lt = pred[] fusion(%get-tuple-element.2, %constant.4), kind=kLoop, calls=%less
}

%cheap (arg.3: f64[9]) -> f64[9] {
  ROOT %copy.1 = f64[9]{0} copy(%arg.3)
}

%dear (arg.4: f64[9]) -> f64[9] {
  %copy.2 = f64[9]{0} copy(%arg.4)
  %scatter.1 = f64[9]{0} scatter(%copy.2, %a, %b), to_apply=%region_2
  ROOT %multiply_fusion = f64[9]{0} fusion(%scatter.1), kind=kLoop, calls=%multiply
}

%outer (arg.5: (s64[], f64[9])) -> (s64[], f64[9]) {
  %while.1 = (s64[], f64[9]) while(%tuple.2), condition=%until, body=%inner, config={"known_trip_count":{"n":"5"}}
  %conditional.1 = f64[9]{0} conditional(%p, %x, %y), true_computation=%dear, false_computation=%cheap
  ROOT %tuple.3 = (s64[], f64[9]{0}) tuple(%a, %conditional.1)
}

%outer_condition (arg.6: (s64[], f64[9])) -> pred[] {
  ROOT %and_fusion = pred[] fusion(%x), kind=kLoop, calls=%and
}

ENTRY %main (x.1: f64[9]) -> (s64[], f64[9]) {
  %copy.13 = f64[9]{0} copy(%x.1)
  ROOT %while.2 = (s64[], f64[9]{0}) while(%tuple.11), condition=%outer_condition, body=%outer
}
"""


@pytest.mark.parametrize(
    ("named", "kernels"), [("condition=%outer_condition", 5 * 3 + 3 + 1), ("condition=%no_such_thing", 5 * 3 + 3)]
)
def test_kernels_of_a_turn_are_counted(named, kernels):
    assert kernels_per_turn(PROGRAM.replace("condition=%outer_condition", named)) == kernels
    assert kernels_per_turn("HloModule empty") == 0
