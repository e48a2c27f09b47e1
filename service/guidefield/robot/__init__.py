"""Robots: descriptions read and checked, limits, planning groups, kinematics, and bounds and charges of links.

Files and rooms import downwards alone (service/contracts.toml). A robot isn't changed once it is loaded.
"""
