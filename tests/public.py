"""Public names of the package: those of `sj.`, and those of its namespaces."""

import inspect

import spherejax as sj

NAMESPACES = {
    name: getattr(sj, name)
    for name in (
        "laws", "joints", "forces", "functions", "vehicle", "solvers", "equations", "errors", "results", "studies",
        "files", "compiler",
    )
}  # fmt: skip
"""Modules that hold what moved out of `sj.`; `sj.gallery`, `sj.plot`, `sj.priors` and `sj.runtime` are others."""


def every_name() -> dict[str, object]:
    """What each name stands for, of the top and of the namespaces; a name of both once."""
    found = {name: getattr(space, name) for space in (*NAMESPACES.values(), sj) for name in space.__all__}
    return {name: thing for name, thing in found.items() if not inspect.ismodule(thing)}
