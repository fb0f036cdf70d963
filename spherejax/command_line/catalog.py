"""Names that the command line knows: scenes, joint models, laws, solvers, drift controls; and `spherejax list`."""

import argparse
from collections.abc import Callable, Mapping

import diffrax

import spherejax as sj

SCENES: Mapping[str, Callable[..., sj.Scene]] = {"four-bar": sj.gallery.four_bar}

JOINTS = {
    "ideal": "ball and socket without any gap: constraint equations",
    "dry": "dry contact with clearance, no friction unless --friction is given",
    "friction": "dry contact with clearance and Threlfall's friction, or another by --friction",
    "lubricated": "squeeze film in the clearance, dry contact beyond it",
    "bushing": "an elastomer instead of the clearance",
}

NORMAL_LAWS = {
    "hertz": sj.Hertz,
    "hunt-crossley": sj.HuntCrossley,
    "lankarani-nikravesh": sj.LankaraniNikravesh,
    "gonthier": sj.Gonthier,
    "flores": sj.Flores,
    "exact": sj.ExactRestitution,
}

FRICTION_LAWS = {
    "threlfall": sj.Threlfall,
    "bengisu-akay": sj.BengisuAkay,
    "ambrosio": sj.Ambrosio,
    "brown-mcphee": sj.BrownMcPhee,
    "lugre": sj.LuGre,
}

BOUNDARIES = {"guembel": sj.Guembel, "pinkus-sternlicht": sj.PinkusSternlicht, "sommerfeld": sj.Sommerfeld}

ELASTOMERS = {"radial": sj.RadialElastomer, "vector": sj.VectorElastomer}

SOLVERS = {
    "tsit5": (diffrax.Tsit5, "explicit, order 5"),
    "dopri5": (diffrax.Dopri5, "explicit, order 5"),
    "dopri8": (diffrax.Dopri8, "explicit, order 8: the choice for scenes that are not stiff"),
    "kvaerno5": (diffrax.Kvaerno5, "implicit, order 5, chord iterations that converge below the step's tolerance"),
    "rodas4p": (sj.Rodas4P, "linearly implicit, order 4, no iterations"),
    "rodas5p": (sj.Rodas5P, "linearly implicit, order 5: the choice for stiff scenes"),
    "ros34pw2": (sj.Ros34PW2, "linearly implicit, order 3: fastest on stiff scenes at low accuracy"),
}

DRIFT_CONTROLS = {
    "baumgarte": (sj.Baumgarte, "feedback of the violations in the equations, alpha = beta = 5 1/s"),
    "projection": (sj.Projection, "every step ends on the constraints, to rounding"),
    "post-stabilization": (sj.PostStabilization, "one Newton correction after each step"),
    "none": (sj.NoDriftControl, "the equations as they are"),
}

UNITS = {
    "mu": "-", "mu_kinetic": "-", "mu_static": "-", "v0": "m/s", "v1": "m/s", "kappa": "s/m",
    "restitution": "-",
    "stribeck_velocity": "m/s", "bristle_stiffness": "1/m", "bristle_damping": "s/m", "viscous": "s/m",
    "stiffness": "N/m", "damping": "s", "exponent": "-",
}  # fmt: skip

DESCRIPTION = """\
Name everything that can be asked for: scenes, joint models, force laws with their parameters and
defaults, solvers and drift controls.
"""

EPILOG = """example:
  spherejax list
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
    parser.set_defaults(action=list_names)


def list_names(options: argparse.Namespace) -> int:
    """Print the catalog."""
    from spherejax.command_line.printing import print_table

    del options
    scenes = [(name, (build.__doc__ or "").splitlines()[0]) for name, build in SCENES.items()]
    print_table("Scenes", ("name", "what"), scenes)
    print_table("Joint models (--joint)", ("name", "what"), list(JOINTS.items()))
    print_table("Normal laws (--normal)", ("name", "parameters and defaults"), _with_parameters(NORMAL_LAWS))
    print_table("Friction laws (--friction)", ("name", "parameters and defaults"), _with_parameters(FRICTION_LAWS))
    boundaries = [(name, (law.__doc__ or "").splitlines()[0]) for name, law in BOUNDARIES.items()]
    print_table("Film boundary conditions (--boundary)", ("name", "what"), boundaries)
    print_table("Elastomers (--elastomer)", ("name", "parameters and defaults"), _with_parameters(ELASTOMERS))
    print_table("Solvers (--solver)", ("name", "what"), [(name, what) for name, (_, what) in SOLVERS.items()])
    controls = [(name, what) for name, (_, what) in DRIFT_CONTROLS.items()]
    print_table("Drift control (--drift)", ("name", "what"), controls)
    return 0


def _with_parameters(laws: Mapping[str, type]) -> list[tuple[str, str]]:
    return [(name, parameters_of(law)) for name, law in laws.items()]


def parameters_of(law: type) -> str:
    """Parameters of a law with defaults and units, as one line."""
    import dataclasses

    words = []
    for parameter in dataclasses.fields(law):
        unit = (
            "N/m^n"
            if "exponent" in law.__dataclass_fields__ and parameter.name == "stiffness"
            else UNITS[parameter.name]
        )
        if parameter.default is dataclasses.MISSING:
            words.append(f"{parameter.name} [{unit}]")
        elif parameter.default is None:
            words.append(f"{parameter.name} from radii and materials [{unit}]")
        else:
            words.append(f"{parameter.name} = {parameter.default:g} [{unit}]")
    return ", ".join(words) or "none"
