"""When to be where along a path among obstacles that move: slices of time, the search, the motion that comes of it."""
