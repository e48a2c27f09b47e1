"""Inverse kinematics: configurations that bring a tip to a pose, or why there are none.

The same random state finds the same configurations.
"""
