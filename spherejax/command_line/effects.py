"""`spherejax effects`: what a scene calls for, and what it costs."""

import argparse

from spherejax.command_line.models import add_joint_options
from spherejax.command_line.printing import say
from spherejax.command_line.scenes import add_scene, chosen

DESCRIPTION = """\
Compile a mechanism and print, effect by effect, the states and constraint rows that it adds and its
scalar operations and microseconds per evaluation of the equations of motion, beside the same
mechanism with ideal joints. What a scene does not call for costs nothing.
"""

EPILOG = """examples:
  spherejax effects four-bar --joint friction
  spherejax effects my_mechanism.toml
"""


def add_effects(commands) -> None:
    """The command `effects`."""
    parser = commands.add_parser(
        "effects",
        help="show which effects a scene calls for and what each costs",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_scene(parser)
    add_joint_options(parser)
    parser.set_defaults(action=show_effects)


def show_effects(options: argparse.Namespace) -> int:
    """Print the table of effects."""
    from spherejax.studies.effects import effects

    say(effects(chosen(options).scene(options)))
    return 0
