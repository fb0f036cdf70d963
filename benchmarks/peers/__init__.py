"""The same scenes in other simulators: translators from a `Scene`, for cross-checks. Optional, never of the package."""
