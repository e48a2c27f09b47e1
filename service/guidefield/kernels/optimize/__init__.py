"""The objective of a motion, duration, clearance and limits, by a spline's control points, and its Newton descent.

`planner/optimize` sets all weights, and compares motions by the same objective (`PenalizedObjective.cost`): a term has
to be added to both. It changes which motion is found, not whether it is free.
"""
