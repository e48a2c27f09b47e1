"""Several motions as one: each step planned where the one before ended, put together, certified as a whole."""
