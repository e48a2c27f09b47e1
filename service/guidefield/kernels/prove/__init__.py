"""The smallest distance between bodies at a configuration and along a motion, exact to a tolerance."""
