"""Guide planes: found, reached and crossed by descending the field.

Each step is judged free when it is taken; the motion along the path is certified above, in `planner/`.
"""
