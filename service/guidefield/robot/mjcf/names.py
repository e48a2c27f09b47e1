"""Names of a compiled MJCF; those that it leaves out are made up, and no two of one kind are the same."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from guidefield.robot.mjcf.compilation import import_mujoco

WORLD = "world"
"""MuJoCo's name of its body 0, the root link of the URDF."""


class UniqueNames:
    """Gives out names, each once.

    Args:
        taken: Names that are given already.
    """

    def __init__(self, taken: Iterable[str]) -> None:
        self._taken = set(taken)

    def make(self, wanted: str) -> str:
        """The wanted name, with a number behind it where it is taken."""
        name, number = wanted, 2
        while name in self._taken:
            name, number = f"{wanted}_{number}", number + 1
        self._taken.add(name)
        return name


def named(model: Any, kind: str) -> list[str]:
    """Name of each element of a kind, "" where it has none.

    Args:
        model: `mujoco.MjModel`.
        kind: MuJoCo's word for the kind: `body`, `joint`, `geom`, `site`, `key`, `equality`, `tendon`, `flex`, `mesh`.
    """
    mujoco = import_mujoco()
    counts = {"body": "nbody", "joint": "njnt", "equality": "neq"}
    object_type = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
    count = getattr(model, counts.get(kind, f"n{kind}"))
    return [mujoco.mj_id2name(model, object_type, index) or "" for index in range(count)]


def body_names(model: Any) -> list[str]:
    """Name of each body, `body<index>` where it has none."""
    given = named(model, "body")
    unique = UniqueNames(filter(None, given))
    return [name or unique.make(f"body{index}") for index, name in enumerate(given)]


def joint_names(model: Any) -> list[str]:
    """Name of each joint, `<body>_joint` where it has none."""
    given, bodies = named(model, "joint"), body_names(model)
    unique = UniqueNames(filter(None, given))
    return [name or unique.make(f"{bodies[model.jnt_bodyid[index]]}_joint") for index, name in enumerate(given)]
