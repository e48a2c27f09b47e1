"""The joints that a request plans for, where they stand, how they move, and how they bring the tip to a pose.

Nearly all that plans or judges takes a group; what alike groups share must not depend on where they start.
"""
