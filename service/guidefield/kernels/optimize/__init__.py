"""The objective of a motion, duration, clearance and limits, by a spline's control points, and its Newton descent."""
