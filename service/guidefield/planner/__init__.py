"""From a problem to a certified motion in time.

Handlers make the problem and read the plan. Rooms import downwards alone (service/contracts.toml).
"""
