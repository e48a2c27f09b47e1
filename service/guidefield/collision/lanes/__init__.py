"""The tables of a robot and a scene for the kernels (kernels/collide) that test sixteen configurations at once.

"Lanes" are the sixteen single-precision elements of a SIMD register, one configuration each.
"""
