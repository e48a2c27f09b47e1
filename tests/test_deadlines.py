"""A slice of `tools/attack deadlines`: a service answers in time however large what is asked, and however written."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.deadline_attack import FORMS, SMALL, Ask, late, service, too_late
from tests.deadline_requests import triangles

SHARE = 0.2  # of the largest scenes: reading one takes from 5 to 100 ms, and building it more

SCENES = ["boxes", "triangles", "points"]

OTHERS = [
    *("polygons", "planes", "scene_planes", "step_planes", "places", "movers", "crowd", "moving_mesh", "held", "path"),
    *("trajectory", "samples", "goals", "blocked_goals", "steps", "constraints", "pairs", "frames", "clearances"),
    *("poses", "field"),
]
"""What else there may be much of: each of them was late once, or might be."""

TRIES = 8  # on a busy machine a thread may get its turn late


@pytest.fixture(scope="module")
def ask() -> Iterator[Ask]:
    with service() as ask:
        yield ask


def missed(ask: Ask, kind: str, form: str, allowed: float, share: float) -> bool:
    """Whether answers came too late each time that it was tried."""
    return all(
        any(too_late(seconds, allowed) for seconds, _ in late(ask, kind, form, allowed, share=share))
        for _ in range(TRIES)
    )


@pytest.mark.parametrize("form", FORMS)
def test_answers_come_in_time(ask: Ask, form: str) -> None:
    assert [kind for kind in SCENES if missed(ask, kind, form, 0.05, SHARE)] == []


def test_answers_to_whatever_is_long_come_in_time(ask: Ask) -> None:
    assert [kind for kind in OTHERS if missed(ask, kind, "json", 0.05, 0.1)] == []


def test_a_service_goes_on_with_what_was_late_and_the_next_request_finds_it(ask: Ask) -> None:
    made = triangles(100_000)
    made["scene"]["obstacles"][0]["vertices"] += 0.001 * np.random.default_rng().random()  # nobody has seen it
    assert ask(FORMS["packed"]({**made, "allowed_planning_time": 0.02}))[1].startswith("TIMED_OUT")
    again = FORMS["packed"]({**made, "allowed_planning_time": 0.3})
    assert any(ask(again)[1] == "SUCCESS" for _ in range(30)), "each goes on where the one before ended"


def test_a_small_request_is_answered_as_soon_as_the_worker_is_free(ask: Ask) -> None:
    assert ask(msgspec.json.encode(SMALL | {"recording": "off", "allowed_planning_time": 15.0}))[1] == "SUCCESS"
