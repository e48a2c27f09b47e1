"""The links as bodies: charges, balls, convex parts, points on their surfaces."""
