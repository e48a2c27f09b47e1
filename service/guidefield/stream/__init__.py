"""Streams: pieces of motion among obstacles that move, each of which ends in a proven stop."""
