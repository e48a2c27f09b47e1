"""Several motions as one: each step planned where the one before ended, put together, certified as a whole.

It stands on top of the planner, which may not import it.
"""
