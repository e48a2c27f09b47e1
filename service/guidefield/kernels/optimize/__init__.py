"""The objective of optimising a motion: duration, clearance and limits, by the control points of a spline."""
