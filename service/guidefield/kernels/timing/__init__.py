"""Curves in time: splines, time-optimal speed, extrema."""
