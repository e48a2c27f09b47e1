"""The tables of a robot and a scene for the kernels (kernels/collide) that test sixteen configurations at once.

A SIMD batch is the sixteen single-precision elements of a vector register, one configuration each.
"""
