"""Robots: descriptions read and checked, limits, planning groups, kinematics, and links as bodies and charges."""
