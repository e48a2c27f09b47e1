"""Motions made fast, far from obstacles and within limits, shape and time together.

Results are proposals: `planner/optimized_motion.py` has them certified.
"""
