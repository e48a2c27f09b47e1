"""The problem of a plan, the events of planning, and the endings of plans."""
