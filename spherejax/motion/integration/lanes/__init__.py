"""Many runs of one system side by side, in lanes that never idle."""

from spherejax.motion.integration.lanes.engine import run_in_lanes, steps_in_lanes
from spherejax.motion.integration.lanes.lane import Block, LaneOutcome, LaneProblem, StepLog

__all__ = ["Block", "LaneOutcome", "LaneProblem", "StepLog", "run_in_lanes", "steps_in_lanes"]
