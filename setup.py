"""Names the packages of the wheel: the rooms, which are found, and the data that lies elsewhere in the checkout."""

from setuptools import find_packages, setup

setup(
    packages=[
        *find_packages("service", include=["guidefield*"]),
        "guidefield.docs",
        "guidefield.robots",
        "guidefield.scenes",
    ]
)
