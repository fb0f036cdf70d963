"""From the options of a command to a joint model."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import spherejax as sj
from spherejax.command_line.catalog import (
    BEARING_FILMS,
    BOUNDARIES,
    ELASTOMERS,
    FILMS,
    FRICTION_LAWS,
    JOINTS,
    NORMAL_LAWS,
    USUAL,
    Usual,
)
from spherejax.command_line.numbers import measured_in, number_of, real
from spherejax.foundations.errors import one_of
from spherejax.foundations.units.units import in_si

UNITS = {
    "clearance": "m",
    "socket_radius": "m",
    "length": "m",
    "youngs_modulus": "Pa",
    "viscosity": "Pa s",
    "stiffness": "N/m",
    "damping": "s",
}
"""Of the options that have one."""

CONTACT = ("dry", "friction", "lubricated")


def add_joint_options(parser: argparse.ArgumentParser, *, many: bool = False) -> None:
    """Options that describe the model of the studied joint, or, with `many`, the numbers of all its models at once."""
    if not many:
        parser.add_argument(
            "--joint",
            choices=JOINTS,
            help="model of the studied joint (default: the one that the scene or the file describes)",
        )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="any other number, with or without a unit: rocker.mass=25g, friction.v1=1e-4 of the studied joint, "
        "joints.NAME.model.normal.stiffness=..., forces.NAME.damping=..., gravity=0,0,-1.62; may be repeated",
    )
    gap = parser.add_argument_group("contact and film (dry, friction, lubricated)")
    gap.add_argument(
        "--clearance", type=measured_in(UNITS["clearance"]), metavar="M", help="radial clearance [m] (default: 1e-4)"
    )
    gap.add_argument(
        "--socket-radius",
        type=measured_in(UNITS["socket_radius"]),
        metavar="M",
        help="inner radius of the socket [m] (default: 0.010)",
    )
    gap.add_argument(
        "--length",
        type=measured_in(UNITS["length"]),
        metavar="M",
        help="of the bearing, where the studied joint is revolute [m]: contact of cylinders by Johnson, and with "
        "--joint lubricated the film of a short bearing, or --film long",
    )
    gap.add_argument(
        "--youngs-modulus",
        type=measured_in(UNITS["youngs_modulus"]),
        metavar="PA",
        help="of ball and socket [Pa] (default: 207e9)",
    )
    gap.add_argument(
        "--normal",
        choices=NORMAL_LAWS,
        metavar="LAW",
        help=f"normal contact law: {', '.join(NORMAL_LAWS)} (default: lankarani-nikravesh; with --joint lubricated "
        "hunt-crossley-dissipation)",
    )
    gap.add_argument("--restitution", type=real, metavar="CR", help="coefficient of restitution (default: 0.9)")
    gap.add_argument(
        "--friction",
        type=_law_text,
        metavar="LAW",
        help=f'friction law, {", ".join(FRICTION_LAWS)} or none, with numbers of its own where wanted: "threlfall '
        'v1=0.01" (default: none; threlfall with --joint friction); of all joints of a robot description',
    )
    gap.add_argument("--mu", type=real, help="kinetic friction coefficient (default: 0.1)")
    gap.add_argument(
        "--mu-static", type=real, help="static friction coefficient, where the law has one (default: 0.15)"
    )
    film = parser.add_argument_group("film (lubricated)")
    film.add_argument(
        "--viscosity",
        type=measured_in(UNITS["viscosity"]),
        metavar="PAS",
        help="dynamic viscosity [Pa s] (default: 0.4)",
    )
    film.add_argument(
        "--film",
        choices=[*FILMS, *BEARING_FILMS],
        help="full, or the paper's radial one (default: full); with --length short or long (default: short)",
    )
    film.add_argument("--boundary", choices=BOUNDARIES, help="where the film carries pressure (default: guembel)")
    bushing = parser.add_argument_group("bushing")
    bushing.add_argument(
        "--stiffness",
        type=measured_in(UNITS["stiffness"]),
        metavar="K",
        help="stiffness [N/m] (default: 1e6; suspension: 2e7)",
    )
    bushing.add_argument(
        "--damping",
        type=_damping,
        metavar="B",
        help="damping in proportion to the stiffness, c/k [s] (default: 1e-2; suspension: 1e-3)",
    )
    if not many:
        bushing.add_argument(
            "--elastomer",
            choices=ELASTOMERS,
            help="damping of the radial rate alone, or of all (default: radial)",
        )


class _Coefficient(NamedTuple):
    """What was given for --damping, where it is a coefficient: the text, and c [N s/m]."""

    text: str
    value: float


def _damping(text: str) -> float | _Coefficient:
    """For `type=`: a time [s]; a coefficient [N s/m] is refused when the stiffness is known, see `_ratio`."""
    try:
        return measured_in(UNITS["damping"])(text)
    except argparse.ArgumentTypeError:
        try:
            return _Coefficient(text, in_si(text, "N s/m"))
        except sj.SceneError:
            pass
        raise


def _ratio(damping: float | _Coefficient | None, stiffness: float | None) -> float | None:
    """The damping as a time [s].

    Raises:
        SceneError: for a coefficient, with the time that it is at this stiffness [N/m].
    """
    if not isinstance(damping, _Coefficient):
        return damping
    means = f"--damping {damping.text}: the damping of a bushing is given by its ratio to the stiffness, c/k [s]"
    if stiffness is None or not stiffness > 0:
        raise sj.SceneError(f"{means}; divide {damping.value:g} N s/m by the stiffness, or give a positive --stiffness")
    number = f"{damping.value / stiffness:.4g}"
    raise sj.SceneError(f'{means}. With the stiffness k = {stiffness:g} N/m it is --damping "{number} s"')


def model_from(options: argparse.Namespace) -> sj.joints.AbstractSphericalModel:
    """The joint model that the options ask for.

    Raises:
        SceneError: for an option that the model does not use: ignoring it would answer another question.
    """
    options = argparse.Namespace(**{**vars(options), "joint": options.joint or "ideal"})
    _refuse_unused(options)
    if options.joint == "ideal":
        return sj.Ideal()
    if options.joint == "bushing":
        law = ELASTOMERS[options.elastomer or "radial"]
        stiffness, damping = USUAL.get(getattr(options, "scene", ""), Usual()).bushing
        stiffness = _or(options.stiffness, stiffness)
        return sj.Bushing(law=law(stiffness, _or(_ratio(options.damping, stiffness), damping)))
    material = sj.Material() if options.youngs_modulus is None else sj.Material(youngs_modulus=options.youngs_modulus)
    contact = {
        "socket_radius": _or(options.socket_radius, 0.010),
        "normal": _normal_from(options),
        "friction": _friction_from(options),
        "socket_material": material,
        "ball_material": material,
        "conformity": None if options.length is None else sj.laws.JohnsonCylinder(options.length),
    }
    clearance = _or(options.clearance, 1e-4)
    if options.joint == "lubricated":
        boundary = BOUNDARIES[options.boundary or "guembel"]()
        viscosity = _or(options.viscosity, 0.4)
        return sj.Lubricated(clearance, viscosity=viscosity, boundary=boundary, film=_film_from(options), **contact)
    return sj.Dry(clearance, **contact)


def all_models_from(
    options: argparse.Namespace, like: sj.joints.AbstractSphericalModel | None
) -> dict[str, sj.joints.AbstractSphericalModel]:
    """The five models of a joint with the numbers that the options give; others are those of its own model.

    Args:
        options: with those of `add_joint_options(many=True)`.
        like: the joint's own model.

    Raises:
        SceneError: for options that do not fit together.
    """
    dry, rubbing = (argparse.Namespace(**{**vars(options), "joint": joint}) for joint in ("dry", "friction"))
    has_normal = options.normal is not None or options.restitution is not None
    has_friction = options.friction is not None or options.mu is not None or options.mu_static is not None
    modulus = options.youngs_modulus
    stiffness, damping = USUAL.get(options.scene, Usual()).bushing if options.scene in USUAL else (None, None)
    stiffness = _or(options.stiffness, stiffness)
    return sj.joint_models(
        like,
        clearance=options.clearance,
        socket_radius=options.socket_radius,
        length=options.length,
        normal=_normal_from(dry) if has_normal else None,
        friction=_friction_from(rubbing) if has_friction else None,
        material=None if modulus is None else sj.Material(youngs_modulus=modulus),
        viscosity=options.viscosity,
        film=None if options.film is None else _film_from(options),
        boundary=None if options.boundary is None else BOUNDARIES[options.boundary](),
        stiffness=stiffness,
        damping=_or(_ratio(options.damping, stiffness), damping),
    )


USED_BY: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(
        (
            "clearance",
            "socket_radius",
            "length",
            "youngs_modulus",
            "normal",
            "restitution",
            "friction",
            "mu",
            "mu_static",
        ),
        CONTACT,
    ),
    **dict.fromkeys(("viscosity", "film", "boundary"), ("lubricated",)),
    **dict.fromkeys(("stiffness", "damping", "elastomer"), ("bushing",)),
}


def _refuse_unused(options: argparse.Namespace) -> None:
    for name, joints in USED_BY.items():
        if getattr(options, name) is not None and options.joint not in joints:
            flag = "--" + name.replace("_", "-")
            raise sj.SceneError(f"{flag} means nothing with --joint {options.joint}; it belongs to {', '.join(joints)}")


def _film_from(options: argparse.Namespace) -> sj.laws.AbstractFilm | None:
    name = options.film or ("short" if options.length is not None else None)
    if name is None:
        return None
    is_bearing = name in BEARING_FILMS
    if is_bearing != (options.length is not None):
        what = "needs --length, of the bearing" if is_bearing else "is of a ball; leave --length out"
        raise sj.SceneError(f"--film {name} {what}")
    return cast(Any, BEARING_FILMS[name])(options.length) if is_bearing else FILMS[name]()


def _normal_from(options: argparse.Namespace) -> sj.laws.AbstractNormalLaw:
    held = options.joint == "lubricated" and options.restitution is None
    name = options.normal or ("hunt-crossley-dissipation" if held else "lankarani-nikravesh")
    law = NORMAL_LAWS[name]
    if not issubclass(law, sj.laws.AbstractHysteresisLaw):
        if options.restitution is not None:
            why = "which dissipates nothing" if law is sj.Hertz else "which is damped by its dissipation"
            raise sj.SceneError(f"--restitution means nothing with --normal {name}, {why}")
        return law()
    return cast(Any, law)(restitution=_or(options.restitution, 0.9))


def _friction_from(options: argparse.Namespace) -> sj.laws.AbstractFrictionLaw | None:
    name = options.friction or ("threlfall" if options.joint == "friction" else "none")
    if name == "none":
        if options.joint == "friction":
            raise sj.SceneError("--joint friction with --friction none is --joint dry; say that")
        if options.mu is not None or options.mu_static is not None:
            raise sj.SceneError(
                "--mu means nothing without friction; add --friction threlfall or take --joint friction"
            )
        return None
    return friction_law(options, name)


def friction_law(options: argparse.Namespace, text: str | None = None) -> sj.laws.AbstractFrictionLaw | None:
    """The law that `--friction`, `--mu` and `--mu-static` describe.

    Raises:
        SceneError: for a number that the law has not.
    """
    name, *numbers = (text or options.friction).split()
    if name == "none":
        return None
    law = FRICTION_LAWS[name]
    fields = [field.name for field in dataclasses.fields(law)]
    given = {"mu" if "mu" in fields else "mu_kinetic": options.mu, "mu_static": options.mu_static}
    given = {key: value for key, value in given.items() if value is not None}
    if "mu_static" in given and "mu_static" not in fields:
        raise sj.SceneError(f"--mu-static means nothing with --friction {name}, which has no static friction")
    for number in numbers:
        key, _, value = number.partition("=")
        if key not in fields:
            raise sj.SceneError(f"--friction {options.friction}: {name} has no number {key!r}; {one_of(fields, key)}")
        given[key] = number_of("--friction", options.friction, value)
    return law(**given)


def _law_text(text: str) -> str:
    """A law of friction by name, with numbers of its own; for `type=` of an option."""
    name = text.split()[0] if text.split() else text
    if name not in (*FRICTION_LAWS, "none"):
        raise argparse.ArgumentTypeError(f"there is no law {name!r}; {one_of([*FRICTION_LAWS, 'none'], name)}")
    return text


def _or(value, default):
    return default if value is None else value
