"""The thesis' planner: descents on guide planes, what is free across them, a coarse way for the tip."""
