"""MJCF: robots described for MuJoCo, compiled by MuJoCo itself and written as a URDF and an SRDF."""
