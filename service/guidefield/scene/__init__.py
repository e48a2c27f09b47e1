"""Scenes: obstacles and guide planes, built from messages, ready to plan in."""
