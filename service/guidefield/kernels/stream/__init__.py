"""Streams: the judge of a commit (`judge`, `separation`, `curves`), which calls nothing else, and what plans for it."""
