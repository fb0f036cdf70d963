from .files.fields.number_units import DescribedNumber, numbers
from .model.system import System, compile_scene
from .motion.results.motion_state import MotionState
from .motion.runs.ode import EquationsOfMotion, Ode, ode
from .motion.runs.stepping import advance, start

__all__ = [
    "DescribedNumber",
    "EquationsOfMotion",
    "MotionState",
    "Ode",
    "System",
    "advance",
    "compile_scene",
    "numbers",
    "ode",
    "start",
]
