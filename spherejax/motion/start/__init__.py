"""A consistent start: assembly, what is redundant or in conflict, rest, and the scales by which errors are judged."""
