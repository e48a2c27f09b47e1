"""Robots: descriptions read and checked, limits, planning groups, kinematics, and links as bodies and charges.

Rooms import downwards alone (service/contracts.toml). A robot isn't changed once it is loaded.
"""
