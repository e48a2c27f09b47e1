"""Robots: loading, limits, groups, kinematics, charges."""
