"""Capsules about links along a motion: a test that they stay apart from everything."""
