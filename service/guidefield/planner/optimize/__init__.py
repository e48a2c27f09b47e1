"""Motions made fast, far from obstacles and within limits, shape and time together."""
