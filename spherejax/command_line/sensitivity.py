"""`spherejax sensitivity`: which parameter of a scene matters when, as table and pictures."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

import spherejax as sj
from spherejax.command_line.catalog import SOLVERS
from spherejax.command_line.models import USED_BY, add_joint_options
from spherejax.command_line.numbers import measured_in, number_of, number_of_samples, real, whole
from spherejax.command_line.printing import say
from spherejax.command_line.scene_numbers import UnitOf, number_at, require_quantities, unit_of_option, units_in
from spherejax.command_line.scenes import Chosen, add_scene, chosen
from spherejax.command_line.shown import sensitivities_in_units
from spherejax.command_line.sweep import builder

DESCRIPTION = """\
Derivatives of what is observed of a motion by parameters, along time. A parameter is a number of the
studied joint (clearance, mu, restitution, stiffness, ...) or of a body (rocker.mass). The derivatives
are integrated beside the motion with their errors controlled, through contact onsets too. The table
on the terminal ranks the parameters by what 1 % of each changes.
"""

EPILOG = """examples:
  spherejax sensitivity four-bar --joint bushing --by stiffness --by damping --of position.rocker --out s/
  spherejax sensitivity four-bar --joint friction --by clearance --by mu --of velocity.rocker.z
"""

MARKERS = (1.234567e-3, 0.31234567, 0.71234567)
"""Values that no scene has, by which a parameter is found among its numbers; one of them is legal for each."""

FILES = ("sensitivities.csv", "sensitivities.nc")


def add_sensitivity(commands) -> None:
    """The command `sensitivity`."""
    parser = commands.add_parser(
        "sensitivity",
        help="which parameter matters when: derivatives of observables along time",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser, joint="--studied")
    add_joint_options(parser)
    what = parser.add_argument_group("what is asked")
    what.add_argument(
        "--by",
        action="append",
        required=True,
        metavar="NAME[=VALUE]",
        help="a parameter, e.g. stiffness, mu=0.2, rocker.mass, friction.v1; may be repeated",
    )
    what.add_argument(
        "--of",
        dest="observables",
        action="append",
        required=True,
        metavar="QUANTITY",
        help='e.g. "position.rocker", "position.rocker.z [mm]", "reaction.coupler_rocker", "mechanical_energy"; may be '
        "repeated",
    )
    what.add_argument("--samples", type=whole, default=201, metavar="N", help="sample times (default: 201)")
    how = parser.add_argument_group("time, accuracy")
    how.add_argument(
        "--t1", type=measured_in("s"), default=0.5, metavar="S", help="length of the motion [s] (default: 0.5)"
    )
    how.add_argument("--rtol", type=real, default=1e-8, help="relative tolerance of a step (default: 1e-8)")
    how.add_argument("--solver", choices=SOLVERS, help="integrator (default: chosen by the scene)")
    files = parser.add_argument_group("files")
    files.add_argument("--out", metavar="FOLDER", help=f"write {', '.join(FILES)} and pictures to this folder")
    files.add_argument("--overwrite", action="store_true", help="replace files that exist")
    parser.set_defaults(action=find_sensitivities)


def find_sensitivities(options: argparse.Namespace) -> int:
    """Compute, print the ranking, write everything."""
    from spherejax.output.paths import make_folder, require_free

    folder = None if options.out is None else Path(options.out).expanduser()
    if folder is not None:
        for name in FILES:
            require_free(folder / name, overwrite=options.overwrite)
    parameters, options = _parameters(options)
    found = chosen(options)
    names = {name.replace(".", "_"): name for name in parameters}
    build = builder(found, options, names, "--by")
    _parameters(options, units_in(found.scene(options), found.studied))  # a unit of another dimension is refused
    values = {key: _value(found, options, build, names, key, parameters[name]) for key, name in names.items()}
    asked = require_quantities(found.scene(options), options.observables, units=True)
    result = sj.sensitivity(
        build,
        values,
        np.linspace(0.0, options.t1, number_of_samples(options.samples)),
        observables=[*dict.fromkeys(one.name for one in asked)],
        rtol=options.rtol,
        solver=SOLVERS[options.solver]() if options.solver else None,
    )
    result = sensitivities_in_units(result, asked)
    say(result)
    if folder is not None:
        make_folder(folder)
        _write(result, folder, options.overwrite)
    return 0


def _parameters(
    options: argparse.Namespace, unit_of: UnitOf = unit_of_option
) -> tuple[dict[str, float | None], argparse.Namespace]:
    """The parameters of `--by` with their values where given, and the options with these values in them."""
    parameters: dict[str, float | None] = {}
    given = dict(vars(options))
    for text in options.by:
        name, equals, number = text.partition("=")
        if name in parameters:
            raise sj.SceneError(f"--by {name} is given twice")
        parameters[name] = number_of("--by", text, number, unit_of(name)) if equals else None
        if name in USED_BY and parameters[name] is not None:
            given[name] = parameters[name]
    return parameters, argparse.Namespace(**given)


def _value(found: Chosen, options: argparse.Namespace, build: Callable, names, key: str, given: float | None) -> float:
    """The value of a parameter where the derivatives are taken: as given, or as the scene has it."""
    name = names[key]
    if given is not None:
        return given
    own = getattr(options, name, None)
    if own is not None:
        return float(own)
    scene = found.scene(options)
    if "." in name:
        try:
            own = number_at(scene, name, found.studied)
        except sj.SceneError as error:
            raise sj.SceneError(f"--by {error}") from None
        if own.ndim:
            raise sj.SceneError(f"--by {name}: it is numbers of shape {own.shape}; name one")
        return float(own)
    import jax

    numbers = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(scene)])
    for marker in MARKERS:
        try:
            marked = found.scene(argparse.Namespace(**{**vars(options), name: marker}))
        except sj.SceneError:
            continue
        leaves = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(marked)])
        places = np.flatnonzero(leaves == marker)
        if leaves.shape == numbers.shape and places.size:
            return float(numbers[places[0]])
    raise sj.SceneError(f"--by {name}: the scene does not show its value; write --by {name}=VALUE")


def _write(result: sj.studies.Sensitivities, folder: Path, overwrite: bool) -> None:
    from spherejax.output.paths import file_name

    written = [result.save(folder / name, overwrite=overwrite) for name in FILES]
    for name, figure in result.figures().items():
        path = folder / f"{file_name(name)}.png"
        figure.savefig(path)
        written.append(path)
    print(f"wrote {', '.join(str(path) for path in written)}")
