"""Curves in time: splines and lengths, time-optimal speed and schedules, torques, speeds in space, and their bounds."""
