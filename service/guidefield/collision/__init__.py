"""Collision: the robot among obstacles, exact distances, and the certificate of whole motions."""
