"""MJCF: robots described for MuJoCo, compiled by MuJoCo itself and written as a URDF and an SRDF.

The package `mujoco` is an extra, imported on demand alone.
"""
