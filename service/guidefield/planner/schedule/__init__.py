"""Schedules along a path among obstacles that move: slices of time, the search, the motion that keeps a schedule.

Schedules are proposals, which the certificate in time judges (`planner/goal_among_movers.py`).
"""
