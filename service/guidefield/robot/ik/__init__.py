"""Inverse kinematics: configurations that bring a tip to a pose, or why there are none."""
