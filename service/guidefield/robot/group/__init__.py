"""The joints that a request plans for, where they stand and how they move.

Nearly all that plans or judges takes a group; what alike groups share must not depend on where they start.
"""
