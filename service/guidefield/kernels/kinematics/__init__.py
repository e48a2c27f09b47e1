"""Kinematics: placements of joints, links and tips, their motion, and configurations that bring a tip to a place."""
