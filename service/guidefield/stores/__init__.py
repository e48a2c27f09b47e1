"""Stores on disk: runs with their recordings, and the scenes and robots that clients stored."""
