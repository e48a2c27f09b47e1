"""The smallest distance along a whole motion, exact to a tolerance."""
