"""Streams: pieces, their judge, and what comes of them."""
