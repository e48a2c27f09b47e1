"""From a problem to a certified motion in time."""
