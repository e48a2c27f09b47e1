"""Guide planes: found, reached and crossed by descending the field.

Each step is checked when it is taken; the motion along the path is certified above, in `planner/`.
"""
