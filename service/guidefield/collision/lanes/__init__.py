"""The tables of a robot and a scene for the kernels that judge sixteen configurations at once."""
