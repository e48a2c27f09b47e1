"""Scenes: obstacles and guide planes, built from messages, with their tables for kernels, ready to plan in."""
