"""Curves through waypoints, and their timing.

Curves are promises: verdicts and replies are about these very formulas. Timing keeps the limits of rates.
"""
