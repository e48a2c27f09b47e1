"""Guide planes: found, reached and crossed by descending the field.

Steps are judged free as they are taken; what is made of the way is certified above, in `planner/`.
"""
