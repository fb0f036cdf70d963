"""Names that the command line knows: scenes, joint models, laws, solvers, drift controls; and `spherejax list`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import spherejax as sj
from spherejax.files.scenes.solvers import SOLVERS
from spherejax.foundations.parts import Parts, names_in

SCENES = Parts({name.replace("_", "-"): f"spherejax.gallery:{name}" for name in names_in("gallery/__init__.py")})
"""The scenes of the gallery: functions that can be called without arguments."""

SUBJECTS = Parts(
    {name: "spherejax.studies.subjects:" + name.replace("-", "_").upper() for name in ("four-bar", "suspension")}
)
"""The paper's mechanisms, of which `compare` shows more than of others."""

ALIASES = {"a01": "simple-pendulum", "a02": "n-four-bar", "a04": "bricard", "a05": "governor"}
"""Short names of scenes: their numbers in the IFToMM library of benchmark problems."""


class Usual(NamedTuple):
    """What a scene of the gallery takes where the options say nothing.

    Attributes:
        t1: length of the motion [s].
        samples: number of samples.
        bushing: stiffness [N/m] and damping [s] of a bushing in the studied joint.
    """

    t1: float = 2.0
    samples: int = 2001
    bushing: tuple[float, float] = (1e6, 1e-2)


USUAL: Mapping[str, Usual] = {
    "andrews": Usual(0.03),
    "bricard": Usual(10.0),
    "car-axis": Usual(3.0),
    "governor": Usual(10.0),
    "n-four-bar": Usual(10.0),
    "simple-pendulum": Usual(10.0),
    "suspension": Usual(6.0, 6001, (2e7, 1e-3)),
}
"""Scenes that take other values than `Usual()`: those that their sources ask for."""

JOINTS = {
    "ideal": "ball and socket without any gap: constraint equations; with friction in scene files",
    "dry": "dry contact with clearance, no friction unless --friction is given",
    "friction": "dry contact with clearance and Threlfall's friction, or another by --friction",
    "lubricated": "squeeze film in the clearance, dry contact beyond it",
    "bushing": "an elastomer instead of the clearance",
}

NORMAL_LAWS = Parts.of_laws("physics/laws/normal.py")
FRICTION_LAWS = Parts.of_laws("physics/laws/friction.py", without=["Coulomb"])  # which no step can follow at rest
FILMS = Parts.of_laws("physics/laws/films.py", ending="Film")
BEARING_FILMS = Parts.of_laws("physics/laws/bearings.py", ending="Bearing")
BOUNDARIES = Parts.of_laws("physics/laws/film.py")
PRESSURES = Parts.of_laws("physics/laws/pressure.py")
"""How the reaction of an ideal joint with friction is spread."""

ELASTOMERS = Parts.of_laws("physics/laws/elastomer.py", ending="Elastomer")
"""Those that two numbers describe; others are for scene files."""

DRIFT_CONTROLS = Parts(
    {
        "baumgarte": "spherejax.solvers:Baumgarte",
        "projection": "spherejax.solvers:Projection",
        "post-stabilization": "spherejax.solvers:PostStabilization",
        "none": "spherejax.solvers:NoDriftControl",
    },
    {
        "baumgarte": "feedback of the violations in the equations, alpha = beta = 5 1/s",
        "projection": "every step ends on the constraints, to rounding",
        "post-stabilization": "one Newton correction after each step",
        "none": "the equations as they are",
    },
)

ABOUT_FILES = """\
A * marks a key that must be given. Numbers are in the unit in brackets, or texts with another unit: "0.1 mm".
Of a body, rotation may stand instead of quaternion: { axis = [0, 0, 1], angle = "30 deg" }, or
{ sequence = "ZXZ", angles = ["10 deg", "20 deg", 0] } with capital letters for turns about the body's own axes
and small ones for turns about those of the world. One joint may be marked studied = true: the one that --joint
is the model of. A class of your own is named by its file, kind = "my_file.py:MyClass", which must be in the folder of
the scene file, and is run only with --allow-code. Numbers have a point for decimals, 1.5 and never 1,5."""

DESCRIPTION = """\
Name everything that can be asked for: scenes, joint models, force laws with their parameters and
defaults, solvers and drift controls. With --kinds: everything that can stand in a scene file.
"""

EPILOG = """examples:
  spherejax list
  spherejax list --kinds
  spherejax list pid
"""


def add_list(commands) -> None:
    """The command `list`."""
    parser = commands.add_parser(
        "list",
        help="name the scenes, joint models, laws, solvers and drift controls",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "word", nargs="?", metavar="WORD", help="show only entries that contain this word, here and among --kinds"
    )
    parser.add_argument(
        "--kinds", action="store_true", help="name what can stand in a scene file: kinds, their keys and units"
    )
    parser.set_defaults(action=list_names)


def list_names(options: argparse.Namespace) -> int:
    """Print the catalog, or what of it contains a word."""
    show = _Filtered(options.word)
    if not options.kinds:
        _list_parts(show)
    if options.kinds or options.word:
        list_kinds(show)
    if options.word and not show.n_shown:
        raise sj.SceneError(f"nothing that can be asked for contains {options.word!r}; spherejax list names everything")
    if options.kinds and not options.word:
        print(ABOUT_FILES)
    elif not options.word:
        print(
            "A mechanism of your own is a scene file: `spherejax write four-bar --out my.toml` writes one to start "
            "from,\n`spherejax run my.toml` runs it, `spherejax list --kinds` names what can stand in it."
        )
    return 0


class _Filtered:
    """Prints tables, or those of their rows that contain a word.

    Args:
        word: in any case; everything is printed without one.
    """

    def __init__(self, word: str | None):
        self.word = (word or "").lower()
        self.n_shown = 0

    def __call__(self, title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print a table. A row without a first cell belongs to the last one that has it; a kind is shown whole."""
        from spherejax.command_line.printing import print_table

        shown, first, whole, last_shown = [], "", False, ""
        for row in rows:
            if row[0]:
                first, whole = row[0], self.word in row[0].lower()
            if whole or any(self.word in cell.lower() for cell in row[1:]):
                shown.append((first if last_shown != first else "", *row[1:]))
                last_shown = first
        if shown:
            print_table(title, heads, shown)
        self.n_shown += len(shown)


def _list_parts(show: _Filtered) -> None:
    short = {name: f"{name} ({alias})" for alias, name in ALIASES.items()}
    scenes = [(short.get(name, name), (build.__doc__ or "").splitlines()[0]) for name, build in SCENES.items()]
    show("Scenes", ("name", "what"), scenes)
    show("Joint models (--joint)", ("name", "what"), list(JOINTS.items()))
    show("Normal laws (--normal)", ("name", "parameters and defaults"), _with_parameters(NORMAL_LAWS))
    show("Friction laws (--friction)", ("name", "parameters and defaults"), _with_parameters(FRICTION_LAWS))
    films = [(name, (law.__doc__ or "").splitlines()[0]) for name, law in (*FILMS.items(), *BEARING_FILMS.items())]
    show("Films (--film; short and long of a revolute joint, with --length)", ("name", "what"), films)
    boundaries = [(name, (law.__doc__ or "").splitlines()[0]) for name, law in BOUNDARIES.items()]
    show("Film boundary conditions (--boundary)", ("name", "what"), boundaries)
    pressures = [(name, (law.__doc__ or "").splitlines()[0]) for name, law in PRESSURES.items()]
    show("Pressures in ideal joints with friction (in scene files)", ("name", "what"), pressures)
    show("Elastomers (--elastomer)", ("name", "parameters and defaults"), _with_parameters(ELASTOMERS))
    show("Solvers (--solver)", ("name", "what"), list(SOLVERS.words.items()))
    show("Drift control (--drift)", ("name", "what"), list(DRIFT_CONTROLS.words.items()))


def list_kinds(show: _Filtered) -> None:
    """Print what can stand in a scene file."""
    from spherejax.files.fields.kinds import family_names, keys_of, kinds_of
    from spherejax.files.scenes.settings import FIELDS as SETTINGS

    show("[bodies.NAME]", ("key", "what", "meaning"), keys_of(sj.Body))
    for title, family in family_names():
        rows = [
            (kind if first else "", *row)
            for kind, cls in kinds_of(family).items()
            for first, row in _marked(keys_of(cls))
        ]
        show(title, ("kind", "key", "what", "meaning"), rows)
    show("[simulation]", ("key", "what"), [(key, field.what) for key, field in SETTINGS.items()])


def _marked(rows):
    """Rows with a mark at the first; one empty row where there is none."""
    rows = rows or [("", "", "")]
    return [(position == 0, row) for position, row in enumerate(rows)]


def _with_parameters(laws: Mapping[str, type]) -> list[tuple[str, str]]:
    return [(name, parameters_of(law)) for name, law in laws.items()]


def parameters_of(law: type) -> str:
    """Parameters of a law with defaults and units, as one line."""
    import dataclasses

    from spherejax.files.fields.dimensions import FIELDS

    words = []
    for parameter in dataclasses.fields(law):
        unit = FIELDS[law][parameter.name].what
        if parameter.default is dataclasses.MISSING:
            words.append(f"{parameter.name} {unit}")
        elif parameter.default is None:
            words.append(f"{parameter.name} from radii and materials {unit}")
        else:
            words.append(f"{parameter.name} = {parameter.default:g} {unit}")
    return ", ".join(words) or "none"
