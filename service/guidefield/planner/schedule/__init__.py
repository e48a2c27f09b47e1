"""Schedules along a path among obstacles that move: slices of time, the search, the motion that keeps a schedule."""
