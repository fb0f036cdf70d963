"""Solvers by the names that files and the command line use."""

from spherejax.foundations.parts import Parts

_ROSENBROCK = "spherejax.motion.solvers.rosenbrock"

SOLVERS = Parts(
    {
        "tsit5": "diffrax:Tsit5",
        "dopri5": "diffrax:Dopri5",
        "dopri8": "diffrax:Dopri8",
        "dop853": "spherejax.motion.solvers.dop853:Dop853",
        "kvaerno5": "diffrax:Kvaerno5",
        "rodas4p": f"{_ROSENBROCK}:Rodas4P",
        "rodas5p": f"{_ROSENBROCK}:Rodas5P",
        "ros34pw2": f"{_ROSENBROCK}:Ros34PW2",
    },
    {
        "tsit5": "explicit, order 5",
        "dopri5": "explicit, order 5",
        "dopri8": "explicit, order 8: the choice for scenes that are not stiff",
        "dop853": "explicit, order 8: longer steps than dopri8 where stability limits them",
        "kvaerno5": "implicit, order 5, chord iterations that converge below the step's tolerance",
        "rodas4p": "linearly implicit, order 4, no iterations",
        "rodas5p": "linearly implicit, order 5: the choice for stiff scenes",
        "ros34pw2": "linearly implicit, order 3: fastest on stiff scenes at low accuracy",
    },
)
"""Classes, and what each is in a line."""
