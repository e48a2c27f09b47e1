"""The problem of a plan, the events of planning, and the endings of plans.

It is the lowest room of the planner: all others read it, and replies have its words and keys.
"""
