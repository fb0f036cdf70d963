"""Through how many functions a number goes between `sj.simulate` and the compiled run: fewer are easier to follow.

A tolerance, the sample times and a clearance are given values that nothing else has, and a profiler notes which
functions of the package are handed one of them as it is. Those of the compiler and of the program cache are left out.
"""

import sys

import jax
import numpy as np

import spherejax as sj

VALUES = {"rtol": 1.2345e-7, "ts": np.array([0.0, 0.00123456, 0.003]), "clearance": 1.2345e-4}
LEFT_OUT = ("program_cache/", "compiler/")


def is_it(argument: object, value: object) -> bool:
    """Whether an argument is the number, or the array, itself."""
    if isinstance(argument, jax.core.Tracer) or not isinstance(argument, float | np.ndarray | jax.Array):
        return False
    return np.shape(argument) == np.shape(value) and bool(np.all(np.asarray(argument) == value))


def functions_given(value: object) -> list[str]:
    """Functions that are handed the value in a first call of `simulate`, in their order."""
    seen: dict[str, None] = {}

    def noted(frame, event: str, _: object) -> None:
        code = frame.f_code
        _, inside, path = code.co_filename.rpartition("/spherejax/")
        if event != "call" or not inside or path.startswith(LEFT_OUT) or "<" in code.co_name:
            return
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(is_it(frame.f_locals.get(name), value) for name in names):
            seen.setdefault(f"{path}::{code.co_name}")

    scene = sj.gallery.four_bar(sj.Dry(clearance=VALUES["clearance"]))
    sys.setprofile(noted)
    try:
        sj.simulate(scene, VALUES["ts"], rtol=VALUES["rtol"])
    finally:
        sys.setprofile(None)
    return list(seen)


def main() -> None:
    for name in VALUES:
        VALUES["clearance"] *= 1.0001  # of a scene that was met before the numbers are not looked at again
        functions = functions_given(VALUES[name])
        print(f"{name}: {len(functions)} functions\n    {', '.join(functions)}")


if __name__ == "__main__":
    main()
