"""A test that a robot's capsules stay apart from everything along a motion."""
