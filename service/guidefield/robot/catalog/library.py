"""Find the robots that come with guidefield, by name: their files and cards; a robot that a client sent.

Names are the public API's. What needs Pinocchio or MuJoCo stands elsewhere: whoever stores robots stays light.
"""

from __future__ import annotations

import functools
import importlib.resources
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from guidefield.messages.values import RootJoint
from guidefield.robot.model import card as cards
from guidefield.robot.model.card import RobotCard
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, catalog_share


@dataclass(frozen=True)
class SentRobot:
    """A robot as a client sent it."""

    name: str  # the client's name of it
    content: str  # hash of all that was sent; the same content is the same robot
    urdf: str  # text of its URDF
    srdf: str | None  # text of its SRDF
    meshes: Mapping[str, Path]  # files on disk by the URIs that the URDF has for them
    root_joint: RootJoint  # how it stands in the world


OURS = "guidefield"
_PACKAGE = "guidefield.robots"
_CARD = ".card.json"


@dataclass(frozen=True)
class Entry:
    """One name of the catalog."""

    name: str
    card: RobotCard  # its files and defaults
    folder: Path  # folder of the card's paths
    source: str  # the package that it comes from
    family: str  # short name of the folder that its URDF is in; several URDFs of one are variants of a robot


@functools.cache
def entries() -> dict[str, Entry]:
    """Return every name, in alphabetical order: found URDFs, and our cards, which take precedence."""
    return dict(sorted({**_find_entries(), **_ours()}.items()))


def _robots() -> Path:
    return catalog_share() / CATALOG_PACKAGE / "robots"


def _find_entries() -> dict[str, Entry]:
    """Find the URDFs of example-robot-data by the names of their files, or of packages where files share a name."""
    robots = _robots()
    urdfs = sorted(robots.glob("*/*/*.urdf"))
    stems = [path.stem for path in urdfs]
    found: dict[str, Entry] = {}
    for path in urdfs:
        family = _family(path.relative_to(robots))
        name = path.stem.removesuffix("_robot").lower()
        if stems.count(path.stem) > 1:
            name = family
        elif name in found:
            name = path.stem.lower()
        srdf = _srdf_of(path, sorted((robots / path.parts[-3] / "srdf").glob("*.srdf")))
        card = RobotCard(str(path.relative_to(robots)), str(srdf.relative_to(robots)) if srdf else None)
        found[name] = Entry(name, card, robots, CATALOG_PACKAGE, family)
    return found


def _ours() -> dict[str, Entry]:
    robots, ours = _robots(), importlib.resources.files(_PACKAGE)
    found = {}
    for resource in ours.iterdir():
        if resource.name.endswith(_CARD):
            name, card = resource.name.removesuffix(_CARD), cards.decode(resource.read_bytes())
            if (robots / card.urdf).is_file():
                found[name] = Entry(name, card, robots, CATALOG_PACKAGE, _family(Path(card.urdf)))
            else:
                found[name] = Entry(name, card, Path(str(ours)), OURS, name)
    return found


def _family(urdf: Path) -> str:
    return urdf.parts[0].removesuffix("_description").removesuffix("_data").lower()


def _srdf_of(urdf: Path, srdfs: Iterable[Path]) -> Path | None:
    """Find the SRDF of a package named most like a URDF: `arm` and `arm_manipulation` describe `arm_with_hand` too."""
    names = {srdf: srdf.stem.removesuffix("_manipulation") for srdf in srdfs}
    fitting = [srdf for srdf, name in names.items() if f"{urdf.stem}_".startswith(f"{name}_")]
    return max(fitting, key=lambda srdf: (len(names[srdf]), -len(srdf.stem)), default=None)
