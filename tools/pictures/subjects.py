"""The subjects of the gallery: real runs, and how each is pictured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import msgspec

import guidefield
from guidefield.cli import demonstration
from guidefield.messages import codec
from guidefield.messages.requests import GuidePlaneGoal, JointsGoal, PlanRequest, PoseGoal
from pictures.figure import ORANGE, ROBOT, STOP, TO_STOP, Colour, Style, View
from pictures.shots import Faults, Planned, Recorded, beside, clip, segment, sheet, still, tabs

REQUESTS = Path(__file__).resolve().parents[1] / "examples" / "requests"
OBJECTIVES = ("balanced", "time", "clearance")
PATIENT = 60.0
"""Planning time that a busy machine doesn't exceed [s]."""

GROUND = (244, 246, 249)
"""Ground for robots in their own colours: some are white."""

WOOD: Colour = (238, 226, 206, 255)
BLUE: Colour = (120, 156, 190, 255)
SHELF_STYLE = Style(
    ground=GROUND,
    obstacles={"": WOOD, "floor": (226, 230, 236, 255), "book": BLUE, "can": (226, 120, 60, 255)},
    margin=1.2,
)
CLEAR: Colour = (150, 168, 196, 90)
SEE_THROUGH = Style(
    ground=GROUND, obstacles={"": CLEAR, "floor": (226, 230, 236, 255), "door": (228, 108, 40, 255)}, margin=1.2
)
TABLE_STYLE = Style(ground=GROUND, obstacles={"": WOOD, "floor": (226, 230, 236, 255), "box": BLUE}, margin=1.3)
KITCHEN_STYLE = Style(
    ground=GROUND,
    obstacles={"": WOOD, "floor": (226, 230, 236, 255), "can": (226, 120, 60, 255)}
    | dict.fromkeys(("jar", "cereals", "pot", "plate", "bottle", "apple"), BLUE),
    margin=1.5,
)
WITH_TRACE = (*ROBOT, "/path/tip")

THESIS = (
    "seed_a_gates",
    "seed_b_tapered",
    "seed_c_blocked",
    "seed_d_passage_3",
    "seed_d_passage_6",
    "seed_e_L_3",
    "seed_e_L_6",
    "seed_e_S_3",
    "seed_e_S_6",
)


@dataclass(frozen=True)
class Subject:
    """One run: what is asked, how it has to end, and who pictures it."""

    request: PlanRequest
    pictures: Callable[[Planned], Faults]
    status: str = "SUCCESS"

    def made(self, name: str, runs: Path, folder: Path) -> list[str]:
        """Plan its request, record it into `runs`, picture it into `folder`; what is wrong with it."""
        recording = runs / f"{name}.rrd"
        reply = guidefield.answer(self.request, record_to=recording)
        if reply.status.name != self.status:
            return [f"{reply.status.name}: {reply.status.message}"]
        return list(self.pictures(Planned(name, self.request.scene, recording, folder, self.request, reply)))


@dataclass(frozen=True)
class Demonstration:
    """The demonstration of streams, and who pictures it."""

    pictures: Callable[[Recorded], Faults]

    def made(self, name: str, runs: Path, folder: Path) -> list[str]:
        """Have it serve, record it into `runs`, picture it into `folder`; what is wrong with it."""
        served = demonstration.serve(runs, lambda _: None)
        if not (served.same and served.places):
            return [f"{served.places} places are reached, again: {served.same}"]
        return list(self.pictures(Recorded(name, demonstration.SCENE, served.recording, folder)))


@dataclass(frozen=True)
class Comparison:
    """One request, planned with each objective, and how it is drawn."""

    request: PlanRequest
    view: View
    style: Style

    def made(self, name: str, runs: Path, folder: Path) -> list[str]:
        """Plan them, record them into `runs`, picture them beside each other into `folder`; what is wrong with them."""
        planned = []
        for objective in OBJECTIVES:
            request, recording = msgspec.structs.replace(self.request, objective=objective), runs / f"{objective}.rrd"
            reply = guidefield.answer(request, record_to=recording)
            if reply.status.name != "SUCCESS":
                return [f"{objective}: {reply.status.name}: {reply.status.message}"]
            planned.append(Planned(objective, request.scene, recording, folder, request, reply))
        return list(beside(planned, self.view, self.style, folder / f"{name}.webp"))


def _file(name: str) -> PlanRequest:
    request = codec.decode_request((REQUESTS / f"{name}.json").read_bytes())
    return msgspec.structs.replace(request, allowed_planning_time=PATIENT)


IN_A_BOARD = {
    "panda_joint1": 0.13,
    "panda_joint2": 0.21,
    "panda_joint3": -0.09,
    "panda_joint4": -1.24,
    "panda_joint5": 0.17,
    "panda_joint6": 2.37,
    "panda_joint7": 1.11,
}
"""The hand is 17 mm deep in a board of the bookshelf."""

BETWEEN_BOARDS = {
    "panda_joint1": -1.468,
    "panda_joint2": -1.335,
    "panda_joint3": 1.244,
    "panda_joint4": -2.422,
    "panda_joint5": 2.714,
    "panda_joint6": 2.346,
    "panda_joint7": 2.397,
}
"""The hand is between the middle boards of the bookshelf."""

SHELF = View((-0.6, -1.9, 0.75), drawn=WITH_TRACE)

AT_PLACES = (5.44, 11.48)
"""Times at which the first and the second place are reached in the demonstration of streams [s]."""

TABLE = View((-0.5, -1.55, 0.8), drawn=(*ROBOT, STOP, TO_STOP))
KITCHEN = View((-1.2, 0.8, 1.1))

SUBJECTS: dict[str, Subject | Demonstration | Comparison] = {
    "shelf": Subject(demonstration.REQUESTS["demo-pose"][1], partial(clip, view=SHELF, style=SHELF_STYLE)),
    "window": Subject(
        PlanRequest(robot="ur5", scene="wall_with_window", goal=GuidePlaneGoal(), allowed_planning_time=PATIENT),
        partial(clip, view=View((-1.4, -1.5, 0.9), drawn=WITH_TRACE), style=SEE_THROUGH),
    ),
    "door": Subject(_file("door"), partial(clip, view=View((-0.5, -1.3, 1.6), drawn=WITH_TRACE), style=SEE_THROUGH)),
    "gates": Subject(_file("seed_a_gates"), partial(clip, view=View(drawn=WITH_TRACE), style=Style(robot=ORANGE))),
    "stream": Demonstration(partial(segment, begin=AT_PLACES[0], end=AT_PLACES[1], view=TABLE, style=TABLE_STYLE)),
    "kitchen": Subject(_file("kitchen"), partial(clip, view=KITCHEN, style=KITCHEN_STYLE)),
    "objectives": Comparison(
        PlanRequest(
            robot="panda",
            scene="bookshelf",
            start=BETWEEN_BOARDS,
            goal=PoseGoal(position=(0.57, 0.05, 0.83), quaternion_xyzw=(0.0, 0.70710678, 0.0, 0.70710678)),
            guide_planes=[],
            allowed_planning_time=PATIENT,
        ),
        View((-0.12, -1.0, 0.08), drawn=WITH_TRACE),
        replace(SHELF_STYLE, margin=1.05),
    ),
    "failure": Subject(
        PlanRequest(
            robot="panda",
            scene="bookshelf",
            start=IN_A_BOARD,
            goal=JointsGoal(demonstration.IN_FRONT),
            guide_planes=[],
            allowed_planning_time=PATIENT,
        ),
        partial(still, view=SHELF, style=SEE_THROUGH),
        status="START_STATE_IN_COLLISION",
    ),
    "tabs": Subject(demonstration.REQUESTS["demo-guide-planes"][1], tabs),
    **{name: Subject(_file(name), sheet) for name in THESIS},
}
"""By the name of the picture."""
