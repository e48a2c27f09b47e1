"""The links as bodies: charges, balls, convex parts, points on their surfaces.

They are kept on disk by the code that made them. Bounds may be coarser, but have to contain the links, and
inscribed balls to lie inside.
"""
