"""Contacts: which pairs of bodies touch at a configuration, and how deep."""

from __future__ import annotations

from dataclasses import dataclass

from guidefield.collision.world import World
from guidefield.robot.model.spaces import ModelConfiguration


@dataclass(frozen=True)
class Contact:
    """Names of a link and a link or obstacle that touch; how far they must part to be free [m], None of a surface."""

    pair: tuple[str, str]
    depth: float | None


def contacts_at(world: World, q: ModelConfiguration) -> list[Contact]:
    """Every pair that touches at a configuration of the model, shape (model.nq,), in the order of the world's pairs.

    What a held object touches wherever the planned joints are comes first.
    """
    return [*(Contact(*one) for one in world.held_contacts), *contacts_among(world, world.near(q))]


def contacts_among(world: World, pairs: list[int]) -> list[Contact]:
    """Those of some pairs that touch where the robot is placed."""
    return [Contact(world.pair_names(pair), depth_of(world, pair)) for pair in pairs if world.touches(pair)]


def depth_of(world: World, pair: int) -> float | None:
    """How deep the bodies of a pair that touches are in each other where the robot is placed; see `Contact.depth`."""
    if not world.is_signed(pair):
        return None
    return max(0.0, -world.distance(pair)[0])
