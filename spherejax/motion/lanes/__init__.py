"""Many runs of one system side by side, in lanes that never idle."""

from spherejax.motion.lanes.engine import Block, LaneOutcome, LaneProblem, run_in_lanes

__all__ = ["Block", "LaneOutcome", "LaneProblem", "run_in_lanes"]
