"""The steps of explicit Runge-Kutta and of Rosenbrock methods: described once, as array code and in machine code."""

from spherejax.compiler.runge_kutta.explicit import explicit_stages
from spherejax.compiler.runge_kutta.rosenbrock import RosenbrockSystems
from spherejax.compiler.runge_kutta.tableau import Tableau, combined

__all__ = ["RosenbrockSystems", "Tableau", "combined", "explicit_stages"]
