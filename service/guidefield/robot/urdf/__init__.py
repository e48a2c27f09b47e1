"""What is in a URDF and an SRDF, read strictly."""
